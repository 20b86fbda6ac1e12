"""Filtering many frames locally: order, threads, reading ahead, and faults."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest

from filter_core.config.filter import FilterConfig
from filter_core.errors import LayoutError
from filter_core.formats.export import ExportFrame
from filter_core.formats.reading import FrameSet, FrameSource
from filter_core.formats.registry import FORMATS, read_source
from filter_core.local import (
    Shown,
    export_sources,
    filter_one,
    filter_source,
    recognise_recording,
)
from filter_core.segmentation.palettes import FAMILIES
from filter_core.types import NOT_MEASURED
from tests.support.folders import street_tags, write_files
from tests.support.pictures import painted, pixels_of, png
from tests.support.sensors import (
    ANNOTATION,
    depth_png,
    instance_png,
    scene,
    street_metres,
)
from tests.support.shared_data import shared


@pytest.fixture
def folder(tmp_path):
    """Twelve YOLO frames; the segmentation of the fourth is cut off."""
    files: dict[str, object] = {"classes.txt": "car\nwalker\n"}
    for number in range(12):
        files[f"images/{number:03}.png"] = None
        files[f"labels/{number:03}.txt"] = (
            "0 0.375 0.41666667 0.5 0.5\n1 0.8125 0.79166667 0.125 0.25\n"
        )
        tags = png(painted(street_tags((10, 10, 50 - number, 40))))
        files[f"seg/{number:03}.png"] = tags[:100] if number == 3 else tags
    return write_files(tmp_path, files)


def test_frames_are_filtered_in_order_despite_an_invalid_frame(folder):
    outcomes = list(filter_source(read_source(folder), FilterConfig()))

    assert [one.key for one in outcomes] == [f"{number:03}" for number in range(12)]
    bad = {one.key: one.error["code"] for one in outcomes if one.error}
    assert bad == {"003": "bad_image"}
    verdicts = [[box["verdict"] for box in one.decisions or ()] for one in outcomes]
    assert verdicts[0] == ["kept", "rejected"]
    assert outcomes[0].palette == "carla-0.9.14"


def test_result_does_not_depend_on_the_number_of_workers(folder):
    lines = [
        [
            json.dumps(one.as_dict(), allow_nan=False)
            for one in filter_source(
                read_source(folder), FilterConfig(), workers=workers
            )
        ]
        for workers in (1, 2, 7)
    ]

    assert lines[0] == lines[1] == lines[2]


def test_only_a_few_frames_are_read_ahead():
    taken = 0

    def endless():
        nonlocal taken
        while True:
            taken += 1
            yield FrameSource(f"{taken}", {"boxes": [], "camera": SIZE})

    outcomes = filter_source(endless(), FilterConfig(), workers=2)

    assert [next(outcomes).key for _ in range(5)] == ["1", "2", "3", "4", "5"]
    assert taken <= 20
    outcomes.close()


SIZE = {"width": 80, "height": 60}


def test_all_annotation_faults_are_in_the_outcome_error():
    boxes = [{"class": "car"}, {"class": "car", "xyxy": [1, 2, 3]}]
    source = FrameSource("k", {"boxes": boxes, "camera": SIZE})

    (outcome,) = filter_source([source], FilterConfig())

    assert outcome.error is not None
    assert outcome.error["code"] == "bad_annotation"
    pointers = [one["pointer"] for one in outcome.error["errors"]]
    assert pointers == ["/boxes/0", "/boxes/1/xyxy"]


def test_outcome_error_lists_100_faults_and_counts_the_rest():
    boxes = [{"class": "car"}] * 1000
    source = FrameSource("k", {"boxes": boxes, "camera": SIZE})

    (outcome,) = filter_source([source], FilterConfig())

    assert outcome.error is not None
    more = outcome.error["more_errors"]
    assert (len(outcome.error["errors"]), more) == (100, 900)


def test_missing_file_is_named_without_its_folder(tmp_path):
    source = FrameSource(
        "k", {"boxes": [], "camera": SIZE}, segmentation=tmp_path / "gone.png"
    )

    (outcome,) = filter_source([source], FilterConfig())

    assert outcome.error is not None
    assert "gone.png" in outcome.error["detail"]
    assert str(tmp_path) not in outcome.error["detail"]


@pytest.mark.parametrize("kind", ["segmentation", "image"])
def test_pipe_in_place_of_an_image_is_refused_without_waiting(tmp_path, kind):
    os.mkfifo(tmp_path / "pipe.png")
    annotation = {"boxes": []} if kind == "image" else {"boxes": [], "camera": SIZE}
    source = FrameSource("k", annotation, **{kind: tmp_path / "pipe.png"})

    (outcome,) = filter_source([source], FilterConfig())

    assert outcome.error is not None
    assert outcome.error["detail"].endswith(
        f"{kind}: pipe.png cannot be read: not a regular file"
    )


def test_ignore_mask_file_of_a_frame_is_applied(folder):
    mask = (street_tags() == 14).astype("uint8") * 255
    write_files(folder, {"mask.png": png(mask)})
    frame = next(iter(read_source(folder)))
    masked = FrameSource(
        frame.key,
        frame.annotation,
        frame.image,
        frame.segmentation,
        others={"ignore_mask": folder / "mask.png"},
    )

    (outcome,) = filter_source([masked], FilterConfig())

    assert [box["matched_pixels"] for box in outcome.decisions or ()] == [0, 0]


def test_a_channel_reads_the_files_that_it_needs(tmp_path):
    tags, metres, ids = scene()
    files = {
        "depth": depth_png(metres),
        "instances": instance_png(tags, ids),
        "lidar": b"not read",
    }
    for kind, content in files.items():
        (tmp_path / kind).write_bytes(content)
    (tmp_path / "seg").write_bytes(png(painted(tags)))
    source = FrameSource(
        "a",
        ANNOTATION,
        segmentation=tmp_path / "seg",
        others={kind: tmp_path / kind for kind in files},
    )

    def outcome(channel):
        return filter_one(source, FilterConfig(evidence=channel)).as_dict()

    assert outcome("depth")["decisions"][1]["reason"] == "hidden_by_depth"
    assert outcome("auto")["decisions"][1]["reason"] == "hidden_by_instance"
    assert "PLY or NPY" in outcome("lidar")["error"]["detail"]


def test_depth_images_of_a_recording_have_one_encoding(tmp_path):
    street, wall = street_metres(), np.full((48, 64), 5.0)
    swapped = {"a.png": street, "b.png": wall, "c.png": street}
    for name, metres in swapped.items():
        content = png(pixels_of(depth_png(metres))[..., ::-1], "bgr")
        (tmp_path / name).write_bytes(content)
    (tmp_path / "raw.png").write_bytes(depth_png(street))
    (tmp_path / "text.png").write_bytes(b"no image")

    def shown(*names, channels=("depth",), config=None):
        config = config or FilterConfig(evidence="depth")
        frames = [
            FrameSource(name, {}, others={"depth": tmp_path / name}) for name in names
        ]
        keys = recognise_recording(frames, config, channels).keys
        return keys.get("depth_encoding", config.depth_encoding)

    assert shown(*swapped, "text.png") == "carla-bgr"
    assert shown("raw.png", "b.png") == "carla"
    assert shown("a.png", "raw.png") == "auto"
    assert shown("b.png") == "auto"
    assert shown("a.png", channels=("instance",)) == "auto"
    named = FilterConfig(evidence="depth", depth_encoding="carla")
    assert shown("a.png", config=named) == "carla"


BUS = [{"id": "bus", "class": "bus", "xyxy": [10, 10, 50, 40]}]


def tagged_frame(folder, key, family, *tags, raw=False, version=None, order="rgb"):
    """A frame with a road, a vehicle in the middle, and stripes of other tags."""
    palette = FAMILIES[family]
    numbers = np.full((60, 80), palette.tag_of("Road"), np.uint8)
    numbers[10:40, 10:50] = palette.tag_of("Bus" if "Bus" in tags else CAR_OF[family])
    for row, tag in enumerate(tags):
        numbers[row] = palette.tag_of(tag)
    content = numbers if raw else painted(numbers, family)
    (folder / f"{key}.png").write_bytes(png(content, order))
    annotation = {"boxes": BUS} | ({"carla_version": version} if version else {})
    return FrameSource(key, annotation, segmentation=folder / f"{key}.png")


CAR_OF = {
    "carla-0.9.0": "Vehicle",
    "carla-0.9.10": "Vehicle",
    "carla-0.9.14": "Car",
    "paper-table1": "Car and Truck",
}


def as_set(frames):
    return FrameSet("manifest", lambda: iter(frames))


def test_one_family_of_tags_is_told_by_all_images_of_a_recording(tmp_path):
    frames = [
        tagged_frame(tmp_path, "a", "carla-0.9.10"),
        tagged_frame(tmp_path, "b", "carla-0.9.10", "Terrain"),
        tagged_frame(tmp_path, "c", "carla-0.9.10", "Sky"),
    ]
    config = FilterConfig()
    alone = {one.key: one.error for one in filter_source(frames, config)}
    assert alone["a"]
    assert alone["a"]["code"] == "ambiguous_palette"

    shown = recognise_recording(frames, config)
    outcomes = list(filter_source(shown.of(as_set(frames)), config))

    assert shown.keys == {"palette": "carla-0.9.10"}
    assert shown.notes == (
        "tags of carla-0.9.10: told by 1 of the 3 segmentations that were looked at",
    )
    assert [one.palette for one in outcomes] == ["carla-0.9.10"] * 3
    verdicts = [one.decisions[0]["verdict"] for one in outcomes if one.decisions]
    assert verdicts == ["kept"] * 3
    # The user's configuration stays the one that the decisions name.
    assert {one.decisions[0]["config"] for one in outcomes if one.decisions} == {
        config.digest
    }


def test_family_that_raw_tags_of_one_frame_prove_is_that_of_all(tmp_path):
    frames = [
        tagged_frame(tmp_path, "a", "carla-0.9.14", "Bus", raw=True),
        tagged_frame(tmp_path, "b", "carla-0.9.14", "Bus", "RoadLine", raw=True),
    ]

    shown = recognise_recording(frames, FilterConfig())
    outcomes = list(filter_source(shown.of(as_set(frames)), FilterConfig()))

    assert shown.keys == {"palette": "carla-0.9.14"}
    assert [bool(one.error) for one in filter_source(frames, FilterConfig())] == [1, 0]
    assert [one.palette for one in outcomes] == ["carla-0.9.14"] * 2


def test_images_that_prove_several_families_are_an_error_that_names_two(tmp_path):
    frames = [
        tagged_frame(tmp_path, "first", "carla-0.9.14", "Terrain"),
        tagged_frame(tmp_path, "none", "carla-0.9.14"),
        tagged_frame(tmp_path, "last", "carla-0.9.10", "Terrain"),
    ]

    with pytest.raises(LayoutError) as refused:
        recognise_recording(frames, FilterConfig())

    assert refused.value.kind == "several_families"
    assert "first is of carla-0.9.14, last is of carla-0.9.10" in str(refused.value)
    # Who names the palette, or the version of a frame, is not asked.
    named = FilterConfig(palette="carla-0.9.14")
    assert recognise_recording(frames, named).keys == {}
    frames[2] = tagged_frame(
        tmp_path, "last", "carla-0.9.10", "Terrain", version="0.9.12"
    )
    shown = recognise_recording(frames, FilterConfig())
    outcomes = list(filter_source(shown.of(as_set(frames)), FilterConfig()))
    assert [one.palette for one in outcomes] == [
        "carla-0.9.14",
        "carla-0.9.14",
        "carla-0.9.10",
    ]


def test_frame_that_contradicts_the_other_images_is_refused_and_says_so(tmp_path):
    frames = [tagged_frame(tmp_path, "a", "carla-0.9.14", "Terrain")]
    late = tagged_frame(tmp_path, "z", "carla-0.9.10", "Terrain")
    shown = recognise_recording(frames, FilterConfig())

    (outcome,) = filter_source(shown.of(as_set([late])), FilterConfig())

    assert outcome.error
    assert outcome.error["detail"].startswith(
        "the recording says palette carla-0.9.14, the colours that occur prove "
        "carla-0.9.10"
    )


def test_colours_that_no_image_tells_leave_each_frame_to_itself(tmp_path):
    frames = [tagged_frame(tmp_path, key, "carla-0.9.14") for key in "abc"]

    assert recognise_recording(frames, FilterConfig()) == Shown()
    assert recognise_recording([FrameSource("a", {})], FilterConfig()) == Shown()


def test_table_of_the_paper_is_told_only_if_no_version_of_carla_is(tmp_path):
    mixed = [
        tagged_frame(tmp_path, "a", "paper-table1", "Fence", "Bus"),
        tagged_frame(tmp_path, "b", "carla-0.9.14", "Terrain"),
    ]

    assert recognise_recording(mixed[:1], FilterConfig()).keys == {
        "palette": "paper-table1"
    }
    assert recognise_recording(mixed, FilterConfig()).keys == {
        "palette": "carla-0.9.14"
    }


def test_swapped_channels_that_one_image_tells_are_those_of_all(tmp_path):
    frames = [
        tagged_frame(tmp_path, "a", "carla-0.9.14", "Terrain", order="bgr"),
        tagged_frame(tmp_path, "b", "carla-0.9.14", "Sky", order="bgr"),
    ]

    assert recognise_recording(frames, FilterConfig()).keys == {
        "palette": "carla-0.9.14",
        "channel_order": "bgr",
    }


def test_few_images_of_many_are_looked_at_unless_they_tell_nothing(tmp_path):
    plain = tagged_frame(tmp_path, "a", "carla-0.9.14")
    telling = tagged_frame(tmp_path, "b", "carla-0.9.14", "Terrain")

    def looked_at(frames):
        (note,) = recognise_recording(frames, FilterConfig()).notes
        return note.partition("told by ")[2].partition(" segm")[0]

    assert looked_at([telling] * 200) == "5 of the 5"
    # The seventh of twelve that are spread over nine frames, of which three are first.
    assert looked_at([plain, plain, telling, *[plain] * 6]) == "1 of the 5"


def test_recording_of_somebody_else_has_one_family(tmp_path):
    folder = shared("cases/recordings/carla_tutorial")
    config = FilterConfig()

    shown = recognise_recording(read_source(folder), config)
    outcomes = list(filter_source(shown.of(read_source(folder)), config))

    assert [one.palette for one in outcomes] == ["carla-0.9.0"] * 3
    assert "told by 2 of the 3" in shown.notes[0]


def test_explanation_without_segmentation_starts_with_unmeasured():
    boxes = [
        {"class": "zebra", "xyxy": [10, 10, 60, 40]},
        {"class": "car", "xyxy": [10, 10, 60, 40], "distance": 90},
    ]
    camera = {"width": 200, "height": 100, "fov": 90}
    source = FrameSource("a", annotation={"boxes": boxes, "camera": camera})
    config = FilterConfig(max_distance=50)

    (frame,) = export_sources([source], config, needs={"decisions"})

    assert isinstance(frame, ExportFrame)
    for decision in frame.decisions:
        assert decision["reason"] == "no_segmentation"
        assert str(decision["explanation"]).startswith("unmeasured: ")


@pytest.mark.parametrize("form", ["decisions-csv", "decisions-parquet"])
def test_table_exports_get_columns_instead_of_decision_objects(form):
    boxes = [
        {"class": "car", "xyxy": [10, 10, 60, 40], "distance": 7.5},
        {"class": "car", "xyxy": [300, 10, 360, 40]},
    ]
    camera = {"width": 200, "height": 100, "fov": 90}
    source = FrameSource("a", annotation={"boxes": boxes, "camera": camera})

    table, lines = (
        next(export_sources([source], FilterConfig(), needs=FORMATS[name].needs))
        for name in (form, "decisions-jsonl")
    )

    assert isinstance(table, ExportFrame)
    assert isinstance(lines, ExportFrame)
    assert lines.columns is None
    assert table.decisions == ()
    assert table.columns is not None
    assert list(table.boxes.ids) == [one["id"] for one in lines.decisions]
    assert table.columns.config == lines.decisions[0]["config"]
    assert table.columns.matched_pixels.tolist() == [NOT_MEASURED, NOT_MEASURED]
