"""Reading COCO files, also faulty ones: a fault is reported, other frames are read."""

from __future__ import annotations

import json
import tracemalloc

import pytest

from filter_core.annotation.parsing import parse_annotation
from filter_core.errors import LayoutError
from filter_core.formats import coco_index
from filter_core.formats.export import GivenAnnotation
from filter_core.formats.registry import read_source
from tests.support.folders import annotation_of, write_files
from tests.support.shared_data import shared

CATEGORIES = [{"id": 7, "name": "walker"}, {"id": 2, "name": "car"}]


def image(number, name, **more):
    return {"id": number, "file_name": name, "width": 80, "height": 60, **more}


def annotation(number, owner, **more):
    row = {"id": number, "image_id": owner, "category_id": 2, "bbox": [1, 2, 3, 4]}
    return {**row, **more}


def coco(images, annotations, **more):
    document = {"images": images, "annotations": annotations, "categories": CATEGORIES}
    return json.dumps({**document, **more})


def test_annotations_are_joined_to_images_in_any_order(tmp_path):
    rows = [annotation(1, "b"), annotation(2, "a"), annotation(3, "b", category_id=7)]
    document = json.loads(coco([image("a", "x/1.png"), image("b", "x/2.png")], rows))
    backwards = json.dumps(dict(reversed(document.items())), indent=3)
    folder = write_files(
        tmp_path,
        {
            "annotations/instances_train.json": f"\ufeff{backwards}",
            "images/train/x/1.png": None,
            "images/train/x/2.png": None,
            "seg/1.png": None,
        },
    )

    frames = read_source(folder)
    first, second = frames

    assert (frames.layout, frames.classes) == ("coco", ("car", "walker"))
    assert (first.key, second.key) == ("x/1", "x/2")
    assert first.image == folder / "images/train/x/1.png"
    assert first.segmentation == folder / "seg/1.png"
    assert annotation_of(first)["boxes"] == [
        {"id": "2", "class": "car", "xywh": [1, 2, 3, 4]}
    ]
    assert [one["id"] for one in annotation_of(second)["boxes"]] == ["1", "3"]
    assert annotation_of(second)["camera"] == {"width": 80, "height": 60}
    assert frames.unmatched == ()


def test_unknown_coco_keys_are_kept(tmp_path):
    strange = {"xyxy": "no", "distance": "far", "score": 0.5, "segmentation": [[1, 2]]}
    rows = [annotation(1, 1, **strange)]
    content = coco([image(1, "a.png", camera="left", license=4)], rows)

    (frame,) = read_source(write_files(tmp_path, {"boxes.json": content}))

    parsed = parse_annotation(annotation_of(frame))
    given = GivenAnnotation(lambda: parsed.raw, (1, 1))
    assert given.frame_extra() == {"license": 4, "camera": "left"}
    assert given.box_extra(0) == strange
    assert parsed.boxes[0].distance is None


def test_duplicate_annotation_ids_are_replaced_by_indexes(tmp_path):
    rows = [annotation(5, 1), annotation(5, 1)]
    folder = write_files(tmp_path, {"a.json": coco([image(1, "a.png")], rows)})

    (frame,) = read_source(folder)

    boxes = parse_annotation(annotation_of(frame)).boxes
    assert [one.id for one in boxes] == ["0", "1"]


@pytest.mark.parametrize(
    ("images", "rows", "words"),
    [
        ([image(1, "a.png")], [annotation(1, 1, category_id=9)], "annotation '1': ex"),
        ([image(1, "a.png"), image(2, "a.png")], [], "each file_name once, found 'a'"),
        (
            [image(1, "a.png"), image(1, "b.png")],
            [annotation(1, 1)],
            "the 1 boxes belong",
        ),
    ],
)
def test_ambiguous_entry_is_a_problem_of_its_frame_only(tmp_path, images, rows, words):
    good = [*images, image("z", "z.png")]
    folder = write_files(tmp_path, {"a.json": coco(good, rows)})

    *bad, last = read_source(folder)

    assert all(words in str(one.problem) for one in bad)
    assert bad
    assert (last.key, last.problem) == ("z", None)


def test_unmatched_images_and_annotations_are_listed(tmp_path):
    content = coco([image(1, "a.png")], [annotation(1, 2), annotation(2, 3)])
    folder = write_files(tmp_path, {"a.json": content, "images/other.png": None})

    frames = read_source(folder)

    assert [(one.path, one.why) for one in frames.unmatched] == [
        ("images/other.png", "no COCO file lists this image"),
        ("a.json", "2 annotations of images that it does not list"),
    ]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ('{"images": [', "byte 12: expected"),
        ('{"images": [{"id": 1}, ]', "byte 23: expected a JSON value"),
        ('{"images": [NaN]}', "NaN is not a JSON number"),
        ('{"images": [{"name": 1}]}', "expected an object with 'id'"),
        ('{"images": [true]}', "expected an object with 'id'"),
        ('{"images": {}}', "expected an object with 'id'"),
        ("[]", "byte 0: expected '{'"),
        ("", "expected more, found the end"),
        ("{}", "expected images, annotations and categories, found nothing"),
        ('{"images": [], "categories": [{"id": 1}]}', "category 1: expected a name"),
        (
            '{"images": [], "categories": [{"id": 1, "name": "a"}, '
            '{"id": 1, "name": "b"}]}',
            "each category id once, found 1 for 'a' and 'b'",
        ),
        ('{"images": [], "categories": [], "x": ' + "[" * 200_000, "expected a JSON"),
        (
            '{"x": ' + "1" * 101,
            "x.json, byte 6: expected JSON in UTF-8, found a number of more than 100 "
            "characters",
        ),
        ('{"images": [{"id": 1, "n": -0.' + "1" * 5000 + "}]}", "byte 27: expected"),
        (
            '{"x": [[' + "1," * 500_000 + "1]]}",
            "byte 7: expected JSON in UTF-8, found JSON of more than 500000 values",
        ),
    ],
)
def test_invalid_coco_file_error_names_the_position(tmp_path, content, words):
    file = tmp_path / "x.json"
    file.write_text(content, "utf-8")

    with pytest.raises(LayoutError) as caught:
        list(read_source(file, "coco"))

    assert words in caught.value.detail


def test_overlong_number_is_refused_for_any_piece_size(tmp_path):
    file = tmp_path / "x.json"
    file.write_text('{"é\\"": "' + "1" * 200 + '", "a": ' + "1" * 1_000_000)

    for size in (1, 7, 50, 200, 500):
        with (
            file.open("rb") as opened,
            pytest.raises(LayoutError, match="byte 218: expected JSON in UTF-8, found"),
        ):
            list(coco_index.read_object(opened, "x.json", piece_bytes=size))


@pytest.mark.parametrize("filling", ["[],", '{"":0},', "0,"])
def test_value_of_too_many_values_is_refused_before_it_is_parsed(tmp_path, filling):
    file = tmp_path / "x.json"
    file.write_text('{"images": [[' + filling * (15_000_000 // len(filling)) + "0]]}")

    tracemalloc.start()
    try:
        with pytest.raises(LayoutError, match="more than 500000 values"):
            list(read_source(file, "coco"))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()

    assert peak < 5 * file.stat().st_size


def test_values_are_complete_for_any_piece_size(tmp_path):
    texts = ["é" * 5, '\\"]}', "\u2028", "x"]
    images = [image(n, f"{text}.png", n=-12345.678) for n, text in enumerate(texts)]
    content = json.dumps({"n": 123456, "images": images}, ensure_ascii=False)
    file = tmp_path / "x.json"
    file.write_text(content, "utf-8")

    for size in range(1, 40):
        with file.open("rb") as opened:
            items = list(coco_index.read_object(opened, "x", piece_bytes=size))
        found = [
            coco_index.decode_value(content.encode()[one.start : one.end], "x")
            for one in items
        ]
        assert found == [123456, *images]


def test_recorded_coco_file_with_errors_is_read_and_reported():
    """Of its 249 images 57 are called "_semantic": one bad frame, and 192 good ones."""
    folder = shared("data/DanielHfnr_Carla-Object-Detection-Dataset")

    frames = read_source(folder, "coco")
    read = list(frames)

    assert frames.classes == (
        "vehicle",
        "bike",
        "motobike",
        "traffic_light",
        "traffic_sign",
    )
    (bad,) = [one for one in read if one.problem]
    assert (len(read), bad.key) == (193, "_semantic")
    assert "images[37], images[38], images[39] and 54 more" in str(bad.problem)
    good = [parse_annotation(annotation_of(one)) for one in read if not one.problem]
    assert sum(len(one.boxes) for one in good) + 192 == 1839
    assert "it is not known to which the 192 boxes belong" in str(bad.problem)
    missing = {one.why for one in frames.unmatched}
    assert missing == {"no COCO file lists this image"}
