"""Reading COCO files, also faulty ones: a fault is reported, other frames are read."""

import json
import tracemalloc

import pytest

from filter_core.annotation.parsing import parse_annotation
from filter_core.errors import AnnotationErrors, LayoutError
from filter_core.formats.export import GivenAnnotation
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.registry import read_source
from filter_core.formats.tables import json_items
from tests.support.folders import annotation_of, write_files

CATEGORIES = [{"id": 7, "name": "walker"}, {"id": 2, "name": "car"}]


def image(number, name, **more):
    return {"id": number, "file_name": name, "width": 80, "height": 60, **more}


def annotation(number, owner, **more):
    row = {"id": number, "image_id": owner, "category_id": 2, "bbox": [1, 2, 3, 4]}
    return {**row, **more}


def coco(images, annotations, **more):
    document = {"images": images, "annotations": annotations, "categories": CATEGORIES}
    return json.dumps({**document, **more})


A, B = image(1, "a.png"), image(2, "b.png")


def read(folder, images, rows, files=(), **more):
    """The frames of a folder with a COCO file and other, empty ones."""
    content = coco(images, rows, **more)
    return read_source(write_files(folder, {"a.json": content, **dict.fromkeys(files)}))


def ids_of(frames):
    return [[box["id"] for box in annotation_of(frame)["boxes"]] for frame in frames]


def test_annotations_are_joined_to_images_in_any_order(tmp_path):
    rows = [annotation(1, "b"), annotation(2, "a"), annotation(3, "b", category_id=7)]
    document = json.loads(coco([image("a", "x/1.png"), image("b", "x/2.png")], rows))
    backwards = json.dumps(dict(reversed(document.items())), indent=3)
    names = ("images/train/x/1.png", "images/train/x/2.png", "seg/1.png")
    write_files(tmp_path, dict.fromkeys(names))
    write_files(tmp_path, {"annotations/instances_train.json": f"\ufeff{backwards}"})

    frames = read_source(tmp_path)
    first, second = frames

    assert (frames.layout, frames.classes) == ("coco", ("car", "walker"))
    assert (first.key, second.key) == ("x/1", "x/2")
    assert first.image == tmp_path / "images/train/x/1.png"
    assert first.segmentation == tmp_path / "seg/1.png"
    (box,) = annotation_of(first)["boxes"]
    assert box == {"id": "2", "class": "car", "xywh": [1, 2, 3, 4]}
    assert ids_of([second]) == [["1", "3"]]
    assert annotation_of(second)["camera"] == {"width": 80, "height": 60}
    assert frames.unmatched == ()


def test_unknown_coco_keys_are_kept(tmp_path):
    strange = {"xyxy": "no", "distance": "far", "score": 0.5, "segmentation": [[1, 2]]}
    images = [image(1, "a.png", camera="left", license=4)]

    (frame,) = read(tmp_path, images, [annotation(1, 1, **strange)])

    parsed = parse_annotation(annotation_of(frame))
    source = GivenAnnotation(lambda: parsed.raw, (1, 1))
    assert source.frame_extra() == {"license": 4, "camera": "left"}
    assert source.box_extra(0) == strange
    assert parsed.boxes[0].distance is None


@pytest.mark.parametrize(
    ("images", "rows", "words"),
    [
        ([A], [annotation(1, 1, category_id=9)], "annotation '1': ex"),
        ([A, image(2, "a.png")], [], "each file_name once, found 'a'"),
        ([A, image(1, "b.png")], [annotation(1, 1)], "the 1 boxes belong"),
    ],
)
def test_ambiguous_entry_is_a_problem_of_its_frame_only(tmp_path, images, rows, words):
    *bad, last = read(tmp_path, [*images, image("z", "z.png")], rows)

    assert all(words in str(frame.problem) for frame in bad)
    assert bad
    assert (last.key, last.problem) == ("z", None)


def test_unmatched_images_and_annotations_are_listed(tmp_path):
    rows = [annotation(1, 2), annotation(2, 3)]

    frames = read(tmp_path, [A], rows, ["images/other.png"])

    rest = "2 annotations of images that it does not list: annotations[0], annotations["
    image, file = [(file.path, file.why) for file in frames.unmatched]
    assert image == ("images/other.png", "no COCO file lists this image")
    assert file == ("a.json", f"{rest}1]")


NAN = float("nan")


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (annotation(6, None), "[1] (id 6): expected an object with 'image_id'"),
        (annotation(6, NAN), "image_id', a number or text, found NaN"),
        ({"id": 6, "bbox": []}, "(id 6): expected"),
        ({}, "annotations[1]: expected"),
        (None, "annotations[1]: expected"),
        (annotation(6, 9), "1 annotations of images that it does not list"),
    ],
)
def test_annotation_of_no_image_is_reported_and_the_rest_is_read(tmp_path, bad, words):
    frames = read(tmp_path, [A, B], [annotation(5, 1), bad, annotation(7, 2.0)])

    assert ids_of(frames) == [["5"], ["7"]]
    (reported,) = frames.unmatched
    assert reported.path == "a.json"
    assert words in reported.why


@pytest.mark.parametrize("number", [int, float])
@pytest.mark.parametrize("other", [int, float])
def test_a_whole_number_is_the_same_id_with_a_point(tmp_path, number, other):
    row = annotation(number(5), number(1), category_id=number(1))
    categories = [{"id": other(1), "name": "car"}]

    (frame,) = read(tmp_path, [image(other(1), "a.png")], [row], categories=categories)

    (box,) = annotation_of(frame)["boxes"]
    assert (box["id"], box["class"]) == ("5", "car")


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"area": NAN}, 'box 0 (id "6"), area'),
        ({"bbox": [1, 2, NAN, 4]}, 'box 0 (id "6"), xywh[2]'),
        ({"bbox": None}, 'box 0 (id "6"), xywh'),
        ({"bbox": []}, 'box 0 (id "6"), xywh'),
        ({"category_id": None}, "annotation '6': expected the id of a category"),
        ({"category_id": True}, "annotation '6': expected the id of a category"),
        ({"category_id": 1.5}, "expected the id of a category, found '1.5'"),
    ],
)
def test_annotation_that_cannot_be_read_spoils_its_own_frame(tmp_path, wrong, words):
    good, bad = read(tmp_path, [A, B], [annotation(5, 1), annotation(6, 2, **wrong)])

    assert ids_of([good]) == [["5"]]
    problem = bad.problem
    if problem is None:
        with pytest.raises(AnnotationErrors) as caught:
            parse_annotation(annotation_of(bad))
        problem = caught.value
    assert words in str(problem)


@pytest.mark.parametrize(
    ("images", "categories", "words"),
    [
        ([image(None, "a.png")], [], "images[1]: expected an object with 'id'"),
        ([image(3, None)], [], "images[1]: expected a file_name, found null"),
        ([image(3, "/..")], [], 'images[1]: expected a file_name, found "/.."'),
        ([True], [], "images[1]: expected an object with 'id'"),
        ([], [{"id": 3}], "categories[2] (id 3): expected a name, found null"),
        ([], [{"name": "van"}], "categories[2]: expected an object with 'id'"),
        ([], [{"id": 7, "name": "van"}], 'that of "walker", too, and of "van"'),
    ],
)
def test_faulty_image_or_category_is_reported(tmp_path, images, categories, words):
    images, rows = [image("z", "z.png"), *images], [annotation(1, "z")]

    frames = read(tmp_path, images, rows, categories=CATEGORIES + categories)
    (frame,) = frames

    assert [box["class"] for box in annotation_of(frame)["boxes"]] == ["car"]
    assert [words in file.why for file in frames.unmatched] == [True]


def test_ten_faulty_annotations_are_named_and_the_others_counted(tmp_path):
    rows = [annotation(number, None) for number in range(1244)]

    *named, last = [file.why for file in read(tmp_path, [A], rows).unmatched]

    assert len(named) == 10
    assert last == "annotations: 1,234 more like this"


@pytest.mark.parametrize(
    "name",
    [
        "/disk/me/out/images/front/1.png",
        "C:\\data\\front\\1.png",
        "../../front/1.png",
        "/data/local-files/?d=out%2Ffront/1.png",
        "https://host.example/x/front/1.png",
        "s3://bucket/front/1.png",
    ],
)
def test_path_from_elsewhere_is_the_file_whose_path_ends_most_alike(tmp_path, name):
    there = [f"{kind}/{camera}/1.png" for kind in KINDS for camera in ("front", "left")]

    (frame,) = read(tmp_path, [image(1, name)], [annotation(1, 1)], there)

    assert frame.key == "front/1"
    assert frame.image == tmp_path / "images/front/1.png"
    assert frame.segmentation == tmp_path / "seg/front/1.png"


KINDS = ("images", "seg")


def test_paths_from_elsewhere_that_could_be_one_file_get_none(tmp_path):
    names = ["/a/front/1.png", "/b/front/1.png", "/b/left/2.png"]
    images = [image(number, name) for number, name in enumerate(names)]

    frames = read(tmp_path, images, [], ["front/1.png", "x/2.png"])

    image_of = {"x/2": tmp_path / "x/2.png"}
    expected = {"a/front/1": None, "b/front/1": None, **image_of}
    assert {frame.key: frame.image for frame in frames} == expected


@pytest.mark.parametrize("is_absolute", [True, False])
def test_image_elsewhere_is_read_where_it_lies_if_that_is_allowed(
    tmp_path, is_absolute
):
    disk = write_files(tmp_path / "disk", {"1.png": None})
    names = [f"{disk}/1.png" if is_absolute else "../disk/1.png", "/nowhere/2.png"]
    images = [image(number, name) for number, name in enumerate(names)]
    folder = write_files(tmp_path / "town", {"a.json": coco(images, []), "x.png": None})

    def read(**outside):
        frames = read_source(folder, options=RecordingDescription(**outside))
        frame, other = sorted(frames, key=lambda frame: frame.key.endswith("2"))
        assert (other.image, other.problem) == (None, None)
        return frame.image and frame.image.resolve(), frame.problem

    assert read(outside_files=True) == (disk / "1.png", None)
    assert read(roots=(disk,)) == (disk / "1.png", None)
    image_path, problem = read()
    assert image_path is None
    assert "a.json, images[0]: expected a file_name in the folder" in str(problem)
    assert "--root DIR" in str(problem)
    assert read(outside_files=None) == (None, None)


@pytest.mark.parametrize("folder", ["", "/disk/me/x/"])
def test_images_that_differ_in_their_suffix_are_two_frames(tmp_path, folder):
    images = [image(1, f"{folder}a.png"), image(2, f"{folder}a.jpg")]
    rows = [annotation(1, 1), annotation(2, 2, category_id=7)]

    frames = read(tmp_path, images, rows, ["images/a.png", "images/a.jpg", "seg/a.png"])
    jpeg, lossless = frames

    assert frames.unmatched == ()
    assert (jpeg.key, lossless.key) == ("a.jpg", "a.png")
    pictures = [tmp_path / "images" / frame.key for frame in frames]
    assert [frame.image for frame in frames] == pictures
    assert [frame.segmentation for frame in frames] == [None, tmp_path / "seg/a.png"]
    classes = [annotation_of(frame)["boxes"][0]["class"] for frame in frames]
    assert classes == ["walker", "car"]


def test_letter_that_is_no_utf8_or_id_that_is_there_twice_spoils_nothing(tmp_path):
    content = coco([A], [annotation(1, 1)]).encode()
    text = content.replace(b'"name"', b'"x": "\xff", "name"', 1)
    write_files(tmp_path, {"a.json": text, "a.png": b""})

    (frame,) = read_source(tmp_path)

    assert len(annotation_of(frame)["boxes"]) == 1
    (frame,) = read(tmp_path / "ids", [A], [annotation(5, 1), annotation(5, 1)])

    boxes = parse_annotation(annotation_of(frame)).boxes
    assert [box.id for box in boxes] == ["0", "1"]


def test_keypoints_beside_instances_are_not_read_twice(tmp_path):
    content = coco([A], [annotation(1, 1, keypoints=[1, 2, 2])])
    names = [f"annotations/{n}_val2017.json" for n in ("instances", "person_keypoints")]
    both = write_files(tmp_path / "both", dict.fromkeys(names, content))
    alone = write_files(tmp_path / "alone", {names[1]: content})

    frames = read_source(both)
    (frame,) = frames
    (other,) = read_source(alone)

    assert (frame.problem, other.problem, frames.unmatched) == (None, None, ())
    assert len(annotation_of(other)["boxes"]) == 1
    note, missing, parts = frames.notes()
    assert "person_keypoints_val2017.json was not read" in note
    assert "images that are listed were not found" in missing
    assert parts == "parts as they came: val2017 1"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ('{"images": [', "byte 12: expected"),
        ('{"images": [{"id": 1}, ]', "byte 23: expected a JSON value"),
        ('{"images": {}}', "expected images, annotations and categories, found images"),
        ("[]", "byte 0: expected '{'"),
        ("", "expected more, found the end"),
        ("{}", "expected images, annotations and categories, found nothing"),
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
            list(json_items.read_object(opened, "x.json", piece_bytes=size))


@pytest.mark.parametrize(
    "filling",
    [
        pytest.param("[],", marks=pytest.mark.long),
        pytest.param('{"":0},', marks=pytest.mark.long),
        "0,",
    ],
)
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
            items = list(json_items.read_object(opened, "x", piece_bytes=size))
        values = [
            json_items.decode_value(content.encode()[item.start : item.end], "x")
            for item in items
        ]
        assert values == [123456, *images]
