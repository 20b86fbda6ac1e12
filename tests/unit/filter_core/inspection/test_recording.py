"""How a folder is understood: what is recognised, and what has to be corrected."""

import json
from dataclasses import replace

import numpy as np
import pytest

from filter_core.errors import LayoutError
from filter_core.formats.reading import RECORDING_NAME, StreamFacts
from filter_core.formats.recording import (
    RecordingDescription,
    describe,
    description_text,
)
from filter_core.formats.splits import Split
from filter_core.inspection.files import Cameras
from filter_core.inspection.labels import Spread
from filter_core.inspection.listing import Counted
from filter_core.inspection.pictures import Reading, Size
from filter_core.inspection.recording import inspect_recording
from filter_core.inspection.remarks import remarks_on
from tests.support.folders import (
    LAYOUT_FILES,
    YOLO_LINE,
    mixed_recording,
    street_tags,
    write_files,
)
from tests.support.frames import write_manifest
from tests.support.pictures import jpeg, painted, png
from tests.support.sensors import depth_png, street_metres
from tests.support.shared_data import shared


def counts(listed):
    """How many things there are of each kind."""
    return {group.kind: group.count for group in listed}


def recognised(inspection):
    """What a recording is taken for, without who says so."""
    return replace(inspection, why="", layouts=(), problems=(), notes=())


@pytest.mark.parametrize("layout", LAYOUT_FILES)
def test_every_layout_is_inspected_and_its_description_gives_the_same(layout, tmp_path):
    root = write_files(tmp_path / "folder", LAYOUT_FILES[layout])

    facts = inspect_recording(root)

    assert (facts.layout, facts.layouts, facts.frames) == (layout, (layout,), 1)
    assert {stream.role for stream in facts.streams} >= {"image"}
    assert facts.left_over == ()
    narrower = "labels of a narrower distance band, whose boxes the widest has, too"
    other_files = {narrower: 1} if layout == "carlasimu" else {}
    assert counts(facts.not_read) == other_files
    text = description_text(facts.described, root)
    assert f"layout: {layout}" in text
    (root / "recording.yaml").write_text(text, "utf-8")
    assert describe(root) == facts.described
    again = inspect_recording(root)
    assert again.why == "as the description says"
    assert recognised(again) == recognised(facts)


def test_everything_that_may_have_to_be_corrected_is_shown(tmp_path):
    facts = inspect_recording(mixed_recording(tmp_path / "street"))

    assert (facts.layout, facts.frames, facts.problems) == ("yolo", 21, ())
    assert facts.streams[0] == StreamFacts(
        "image", 46, "train/images/000.png", ("name",), "{part}/images/{frame}.png"
    )
    assert counts(facts.left_over) == {"no label file for this image": 25}
    assert len(facts.left_over[0].examples) == 10
    unknown = {f"no reader opens *.{suffix}": 1 for suffix in ("md", "bin")}
    assert counts(facts.not_read) == unknown
    assert [(each.name, each.boxes, each.measured_as) for each in facts.classes] == [
        ("car", 42, "car"),
        ("walker", 21, "walker"),
        ("Kasten", 21, None),
        ("Caar", 21, None),
        ("bus", 3, "bus"),
    ]
    car, walker, box, misspelt, _ = facts.classes
    assert (misspelt.nearest, box.nearest, car.tags) == ("car", None, ("Car",))
    assert car.unknown == (Counted("tag 100", 21 * 16 * 16),)
    assert car.unknown_percent == pytest.approx(100 * 256 / (100 * 71 + 60 * 50), 0.05)
    assert (car.kept, walker.looked_at.rejected, box.unmeasured) == (42, 21, 21)
    assert counts(facts.boxes.faults) == {"outside": 3}
    assert facts.boxes.faults[0].examples[0].name == "test/001"
    assert facts.segmentation is not None
    reading = Reading("carla-0.9.14", "raw", "rgb", lossy=False, images=21)
    assert facts.segmentation.readings == (reading,)
    parts = {"test": 3, "train": 14, "valid": 4}
    assert facts.splits == tuple(Split(part, "folder", n) for part, n in parts.items())
    assert facts.cameras == ()
    assert facts.sizes == (Size(320, 180, 21),)
    assert sorted(frame.key.split("/")[0] for frame in facts.drawn) == [*parts]
    verdicts = [box.verdict for box in facts.drawn[0].boxes]
    drawn = [verdicts.count(word) for word in ("kept", "rejected", "unmeasured")]
    assert drawn in ([2, 1, 2], [2, 2, 2])
    assert facts.drawn[0].jpeg is not None


COLOURS = jpeg(painted(street_tags(), "carla-0.9.14"))


@pytest.mark.parametrize(
    ("suffix", "segmentation", "remedy"),
    [
        ("png", png(street_tags()), "Name the palette by `segmentation: {palette: NAM"),
        ("jpg", COLOURS, "`segmentation: {lossy: nearest}` in recording.yaml"),
    ],
)
def test_remedies_are_keys_of_a_description(tmp_path, suffix, segmentation, remedy):
    files = {"images/1.png": None, f"seg/1.{suffix}": segmentation}
    files |= {"labels/1.txt": YOLO_LINE, "classes.txt": "car"}

    facts = inspect_recording(write_files(tmp_path, files))

    texts = [remark.text for remark in remarks_on(facts) if remark.is_serious]
    assert any(remedy in text for text in texts), texts


def test_remarks_name_classes_and_boxes_outside_of_a_frame_are_counted(tmp_path):
    names = ("unknown", "CAAR", "Misc")
    boxes = [{"id": name, "class": name, "xyxy": [1, 1, 9, 9]} for name in names]
    files = {"1.png": png(street_tags()), "1.json": json.dumps({"boxes": boxes})}

    remarks = remarks_on(inspect_recording(write_files(tmp_path, files)))

    (unmapped,) = (remark for remark in remarks if remark.unknown_classes)
    assert unmapped.unknown_classes == ("CAAR", "Misc", "unknown")
    assert unmapped.remedies == [(("classes", "CAAR"), "car")]
    assert unmapped.finding.endswith("CAAR (1), Misc (1), unknown (1)")
    boxes = [{"class": "car", "xyxy": [x, 10, x + 20, 30]} for x in (10, 200, 300)]

    outside = tmp_path / "outside"
    write_files(outside, {"1.png": None, "1.json": json.dumps({"boxes": boxes})})

    (frame,) = inspect_recording(outside).drawn

    assert (len(frame.boxes), frame.outside) == (1, 2)


def test_files_that_the_description_ignores_are_listed_with_this_reason(tmp_path):
    names = ("images/1.png", "images/old/2.png", "labels/old/2.txt")
    write_files(tmp_path, {**dict.fromkeys(names, b""), **LAYOUT_FILES["yolo"]})
    write_files(tmp_path, {RECORDING_NAME: "files: {ignore: ['**/old/*', '**/1.png']}"})

    facts = inspect_recording(tmp_path)

    assert (facts.layout, facts.frames, facts.left_over) == ("yolo", 1, ())
    ignored = "`files.ignore` of the description leaves it out"
    assert counts(facts.not_read) == {ignored: 5}


def test_tutorial_has_one_family_that_some_of_its_images_tell_and_coarse_depth():
    facts = inspect_recording(shared("cases/recordings/carla_tutorial"))

    told = {stream.role: stream.told_by for stream in facts.streams}
    both = ("name", "pixels")
    assert told == {"image": ("pixels",), "depth": ("name",), "segmentation": both}
    tags, depth = facts.segmentation, facts.depth
    assert tags is not None
    assert (tags.family, tags.agreeing, tags.told) == ("carla-0.9.0", 3, 2)
    assert tags.is_certain
    assert facts.described.palette == "carla-0.9.0"
    assert depth is not None
    assert (depth.encoding, counts(depth.refused)) == (None, {"depth_too_coarse": 3})


def test_boxes_in_another_unit_are_read_in_it_and_the_description_says_so(tmp_path):
    boxes = [[10.5, 20.5, 10.5, 30], [40, 10, 5, 8.25], [70, 60, 20, 20]]
    rows = [
        {"id": number, "image_id": 1, "category_id": 1, "bbox": bbox}
        for number, bbox in enumerate(boxes)
    ]
    document = {"images": [{"id": 1, "file_name": "7.png"}], "annotations": rows}
    document["categories"] = [{"id": 1, "name": "car"}]
    # Larger than the part of a file that is read for its size.
    noise = np.random.default_rng(0).integers(0, 256, (600, 800, 3), np.uint8)
    files = {"instances.json": json.dumps(document).encode(), "7.png": png(noise)}
    root = write_files(tmp_path, files)

    facts = inspect_recording(root)

    assert [problem.code for problem in facts.problems] == ["wrong_unit"]
    assert "`boxes: {unit: percent}`" in facts.problems[0].detail
    assert facts.sizes == (Size(800, 600, 1),)
    assert facts.drawn[0].boxes[1].xyxy == pytest.approx((320, 60, 360, 109.5))
    text = description_text(facts.described, root)
    (root / "recording.yaml").write_text(text, "utf-8")
    again = inspect_recording(root)
    assert again.problems == ()
    assert recognised(again) == recognised(facts)


def test_folder_that_cannot_be_read_is_shown_all_the_same(tmp_path):
    picture = png(np.zeros((60, 80, 3), np.uint8))
    root = write_files(tmp_path, {"images/1.png": picture, "labels/1.txt": YOLO_LINE})

    facts = inspect_recording(root)

    assert (facts.layout, facts.frames) == (None, 0)
    assert "`boxes: {classes: [car, bus]}`" in facts.problems[0].detail
    assert [stream.role for stream in facts.streams] == ["image"]
    assert counts(facts.not_read) == {"not read, since the folder cannot be read": 2}
    with pytest.raises(LayoutError, match="found none"):
        inspect_recording(tmp_path / "missing")


def test_folder_of_two_layouts_is_read_in_the_likelier_and_it_is_said(tmp_path):
    root = write_files(tmp_path, {**LAYOUT_FILES["voc"], **LAYOUT_FILES["yolo"]})

    facts = inspect_recording(root)

    assert (facts.layout, facts.layouts) == ("voc", ("voc", "yolo"))
    assert [problem.code for problem in facts.problems] == ["several_layouts"]
    assert "`layout: voc` or `layout: yolo` in" in facts.problems[0].detail
    named = inspect_recording(root, RecordingDescription(layout="yolo"))
    assert (named.layout, named.problems) == ("yolo", ())


def test_frames_that_cannot_be_used_are_listed_by_their_faults(tmp_path):
    inverted = [{"class": "car", "xyxy": [9, 9, 5, 5]}]
    lines = [{"key": f"a/{number}", "boxes": inverted} for number in range(12)]
    lines += [{"key": "b", "boxes": [{"xyxy": [1, 2, 3, 4]}]}, {"key": "c"}]
    camera = {"camera": {"width": 80, "height": 60}}
    text = "".join(f"{json.dumps({**camera, **line})}\n" for line in lines)
    root = write_files(tmp_path, {"manifest.jsonl": text, "1.png": None})

    facts = inspect_recording(root)

    first, second, third = facts.refused
    assert (first.kind, first.count) == ("exchanged_corners", 12)
    assert (len(first.examples), second.count, third.count) == (10, 1, 1)
    assert counts(facts.boxes.faults) == {"inverted": 12}
    assert counts(facts.not_read) == {"no line of the manifest names it": 1}


def test_cameras_parts_and_lists_are_recognised(tmp_path):
    picture = png(np.zeros((60, 80, 3), np.uint8))
    files = {"classes.txt": b"car", "train.txt": b"1\n2\n", "depth_test/x.txt": b""}
    folders = ("CAM_FRONT", "CAM_LEFT")
    for name in ("single/9", *(f"{cam}/{n}" for cam in folders for n in range(4))):
        files |= {f"images/{name}.png": picture, f"labels/{name}.txt": YOLO_LINE}

    facts = inspect_recording(write_files(tmp_path, files))

    assert facts.cameras == (Cameras(tuple(f"images/{cam}" for cam in folders), 4),)
    assert facts.splits == (Split("train.txt", "list", 2),)


def test_files_of_labels_are_parts(tmp_path):
    coco = json.loads(LAYOUT_FILES["coco"]["annotations/instances_val.json"])
    coco["images"][0]["file_name"] = "8.png"
    train = {"annotations/instances_train.json": json.dumps(coco).encode()}
    files = {**LAYOUT_FILES["coco"], **train, "images/8.png": b""}

    facts = inspect_recording(
        write_files(tmp_path, {**files, "ImageSets/Main/val.txt": b"7\n"})
    )

    assert facts.splits == (
        Split("instances_val.json", "labels", 1),
        Split("instances_train.json", "labels", 1),
        Split("ImageSets/Main/val.txt", "list", 1),
    )


def test_depth_and_tags_of_a_recording_are_told_by_its_images(tmp_path):
    root = write_manifest(tmp_path / "frames", 3)
    (root / "depth.png").write_bytes(depth_png(street_metres()))
    lines = (root / "manifest.jsonl").read_text().splitlines()
    with_depth = [{**json.loads(line), "depth": "depth.png"} for line in lines]
    text = "".join(f"{json.dumps(line)}\n" for line in with_depth)
    (root / "manifest.jsonl").write_text(text)

    facts = inspect_recording(root)
    depth = facts.depth

    assert depth is not None
    assert (depth.encoding, depth.shown) == ("carla", (Counted("carla", 3),))
    assert facts.described.depth_encoding == "carla"
    assert facts.with_role["depth"] == 3


def test_image_of_few_colours_does_not_tell_the_family(tmp_path):
    picture = png(np.random.default_rng(0).integers(0, 256, (60, 80, 3), np.uint8))
    for number, tags in enumerate((np.full((60, 80), 11, np.uint8), street_tags())):
        files = {f"rgb/{number}.png": picture, f"seg/{number}.png": png(painted(tags))}
        write_files(tmp_path, files)

    tags = inspect_recording(tmp_path).segmentation

    assert tags is not None
    assert (tags.looked_at, tags.agreeing) == (2, 2)
    assert tags.told < 2


def test_few_pictures_are_looked_at_and_one_of_each_class(tmp_path):
    files = {"data.yaml": b"names: [car, bus]"}
    for number in range(100):
        files[f"images/{number:03}.png"] = png(np.zeros((60, 80, 3), np.uint8))
        files[f"labels/{number:03}.txt"] = b"0 .5 .5 .1 .1\n"
    files["labels/031.txt"] = b"1 .5 .5 .1 .1\n"
    root = write_files(tmp_path, files)
    seen = []

    facts = inspect_recording(
        root, pictures=6, progress=lambda done, of: seen.append((done, of))
    )

    assert (facts.frames, facts.pictures) == (100, 7)
    looked_at = {class_.name: class_.looked_at.boxes for class_ in facts.classes}
    assert looked_at == {"car": 6, "bus": 1}
    assert seen == [(number, 100) for number in range(1, 101)]
    assert inspect_recording(root, pictures=0).drawn == ()


@pytest.mark.parametrize("count", [0, 1, 5, 6, 7, 100, 1001])
def test_spread_takes_evenly_from_any_number_of_things(count):
    spread: Spread[int] = Spread(6)
    for number in range(count):
        spread.add(number)

    things = spread.things

    assert len(things) == min(6, count)
    assert things == sorted(set(things))
    steps = np.diff([*things, count])
    assert len(things) < 6 or steps.max() <= 3 * count / 6 + 1


def test_images_whose_name_and_pixels_disagree_are_a_stream_with_its_pattern(tmp_path):
    tags = png(np.repeat(street_tags()[:, :, None], 3, axis=2))
    write_files(tmp_path, {f"cam/{number}.png": tags for number in (1, 2)})

    inspection = inspect_recording(tmp_path)

    (stream,) = inspection.streams
    assert (stream.role, stream.images) == ("unclear", 2)
    assert stream.pattern == "cam/{frame}.png"
    assert "`files` in recording.yaml" in inspection.left_over[0].examples[0].why
