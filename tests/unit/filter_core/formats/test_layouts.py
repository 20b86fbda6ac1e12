"""Reading folders: their layout is recognised, files matched, the rest listed."""

import json
import os
import unicodedata
from pathlib import Path
from zipfile import ZipFile

import pytest

from filter_core.config.filter import FilterConfig
from filter_core.errors import FilterError, LayoutError
from filter_core.formats.reading import MAX_LABEL_BYTES, frame_key, read_label_bytes
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.registry import detect_layout, possible_layouts, read_source
from filter_core.formats.streams.outside import OUTSIDE_FILES_HINT
from filter_core.local import measure_source
from tests.support.folders import LAYOUT_FILES, TASK, annotation_of, write_files

YOLO_LINE = "0 0.5 0.5 0.1 0.2\n"
EMPTY_COCO = '{"images": [], "annotations": [], "categories": []}'
BOX = {"class": "car", "cxcywhn": [0.5, 0.5, 0.1, 0.2]}
NAMES = "names: [car, van]\n"


def keys(frames):
    return [frame.key for frame in frames]


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("a.png", "a"),
        ("Town05_1.5km.v2.txt", "Town05_1.5km.v2"),
        ("train/images/7.png", "train/7"),
        ("images/train/7.png", "train/7"),
        ("Annotations/my frame.xml", "my frame"),
        ("a/b c/d.e.png", "a/b c/d.e"),
        ("Images/street one/7.PNG", "street one/7"),
        (unicodedata.normalize("NFD", "straße/é.png"), "straße/é"),
    ],
)
def test_frame_key_is_derived_from_the_file_path(name, key):
    assert frame_key(name) == key


@pytest.mark.parametrize(
    ("images", "labels"),
    [
        ("images/train/1.png", "labels/train/1.txt"),
        ("train/images/1.png", "train/labels/1.txt"),
        ("train/1.png", "train/1.txt"),
    ],
)
def test_yolo_is_read_from_any_folder_nesting(tmp_path, images, labels):
    write_files(tmp_path, {images: None, labels: YOLO_LINE, "data.yaml": NAMES})

    frames = read_source(tmp_path)
    (frame,) = frames

    assert (frames.layout, frames.classes) == ("yolo", ("car", "van"))
    annotation = {"boxes": [BOX], "split": "train"}
    assert (frame.key, frame.annotation) == ("train/1", annotation)
    assert frame.image == tmp_path / images
    assert frames.unmatched == ()


def test_unicode_names_are_matched_and_macos_files_are_ignored(tmp_path):
    composed, apart = (
        unicodedata.normalize(form, "é 1.5 km") for form in ("NFC", "NFD")
    )
    files = {f"images/{apart}.png": None, f"labels/{composed}.txt": YOLO_LINE}
    of_macos = ("__MACOSX/labels/._x.txt", "labels/.DS_Store", "labels/._a.txt")
    files |= {"images/__MACOSX/x.png": None, **dict.fromkeys(of_macos, "rubbish")}

    frames = read_source(write_files(tmp_path, {**files, "classes.txt": "car\n"}))

    assert keys(frames) == ["é 1.5 km"]
    assert next(iter(frames)).image is not None
    assert frames.unmatched == ()


def test_unmatched_files_are_listed_with_the_reason(tmp_path):
    images = ("images/a.png", "images/a.jpg", "images/alone.png", "seg/other.png")
    labels = dict.fromkeys(("labels/a.txt", "labels/no image.txt"), YOLO_LINE)
    files = dict.fromkeys(images) | labels | {"classes.txt": "car"}

    frames = read_source(write_files(tmp_path, files))

    assert [(file.path, file.why) for file in frames.unmatched] == [
        ("images/a.png", "same frame as images/a.jpg, which is used"),
        ("images/alone.png", "no label file for this image"),
        ("seg/other.png", "no label file for this segmentation"),
    ]
    assert keys(frames) == ["a", "no image"]


def test_segmentations_in_a_flat_folder_are_matched_by_name(tmp_path):
    images = dict.fromkeys(("images/town/1.png", "tags/1.png", "tags/2.png"))
    names = ("town/1", "a/2", "b/2")
    labels = {f"labels/{name}.txt": YOLO_LINE for name in names}
    write_files(tmp_path, images | labels | {"classes.txt": "car"})

    options = RecordingDescription(segmentation=tmp_path / "tags")
    frames = read_source(tmp_path, options=options)

    tags = {frame.key: frame.segmentation for frame in frames}
    assert tags == {"a/2": None, "b/2": None, "town/1": tmp_path / "tags/1.png"}
    assert [file.path for file in frames.unmatched] == ["2.png"]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("2 0.5 0.5 0.1 0.2", "labels/1.txt, line 2: expected a class from 0 to 1"),
        ("-1 0.5 0.5 0.1 0.2", "found '-1'"),
        ("0 0.5 x 0.1 0.2", "line 2: expected a finite number, found 'x'"),
        ("0 0.5 nan 0.1 0.2", "found 'nan'"),
        ("0 0.5", "line 2: expected 'class cx cy w h' (5 columns)"),
        ("0 0 0 1 0 1 x 0 1", "found 'x'"),
        ("0 0.5 0.5 0.1 0.2 0.9 217", "as a polygon has, found 217"),
    ],
)
def test_invalid_yolo_line_is_reported_and_other_frames_are_read(tmp_path, line, words):
    files = {"labels/1.txt": f"{YOLO_LINE}{line}\n", "labels/2.txt": YOLO_LINE}
    write_files(tmp_path, {**files, "data.yaml": NAMES})

    bad, good = read_source(tmp_path)

    assert words in str(bad.problem)
    assert bad.annotation is None
    assert (good.problem, good.annotation) == (None, {"boxes": [BOX]})


def test_texts_that_are_no_labels_are_no_frames(tmp_path):
    texts = {
        "data.yaml": NAMES,
        "README.roboflow.txt": "\ncarla - v1 2023-11-01 4:20pm\n====\n",
        "README.dataset.txt": "https://a.example\nlicence: CC BY 4.0\n",
        "lists/train.txt": "./images/1.jpg\n./images/2.jpg\n",
        "lists/car_train.txt": "000001 -1\n000002 1\n",
        "lists/names.txt": "car\nbus\n",
        "train/labels/1.txt": YOLO_LINE,
        "train/labels/2.txt": "no numbers at all, but an image of this name",
        "train/labels/3.txt": "",
    }
    images = (f"train/images/{number}.png" for number in (1, 2, 3))
    write_files(tmp_path, {**texts, **dict.fromkeys(images)})

    frames = read_source(tmp_path)
    problems = {frame.key: frame.problem for frame in frames}

    assert (frames.layout, frames.unmatched) == ("yolo", ())
    assert list(problems) == ["train/1", "train/2", "train/3"]
    assert "2.txt, line 1" in str(problems.pop("train/2"))
    assert set(problems.values()) == {None}


@pytest.mark.parametrize("named", [False, True])
def test_texts_among_labels_that_cannot_be_read_are_listed(tmp_path, named):
    damaged = {"b": "0,.5,.5,.2,.2\n", "c": "car;bus\n", "d": "0 .5 .5\n"}
    damaged["e"] = "car .5 .5 of .2 what\n"
    others = {"README": "0, 1, 2\n", "LICENSE": "CC BY 4.0\n"}
    others |= {
        "names": "car\nstreet light\n",
        "paths": "/data/a b 1.png\n/data/2.png\n",
    }
    files = {f"labels/{name}.txt": text for name, text in (damaged | others).items()}
    write_files(tmp_path, {**files, "data.yaml": NAMES, "labels/a.txt": YOLO_LINE})
    labels = tmp_path / "labels" if named else None

    frames = read_source(tmp_path, options=RecordingDescription(labels=labels))

    assert keys(frames) == ["a"]
    prefix = "" if named else "labels/"
    listed = {file.path: file.why for file in frames.unmatched}
    assert list(listed) == [f"{prefix}{name}.txt" for name in damaged]
    assert all("'class cx cy w h'" in why for why in listed.values())


def test_notes_and_lists_are_no_labels_and_hide_no_images(tmp_path):
    write_files(tmp_path, {"a.png": None, "README.roboflow.txt": "carla - v1\n"})

    frames = read_source(tmp_path)

    assert (frames.layout, keys(frames), frames.unmatched) == ("pairs", ["a"], ())
    files = {"labels/classes.txt": "car\n", "labels/train.txt": YOLO_LINE}
    others = {"readme.txt": "hello", "train.txt": "images/train.png"}

    frames = read_source(write_files(tmp_path / "lists", files | others))

    assert (frames.layout, keys(frames)) == ("yolo", ["train"])
    assert frames.classes == ("car",)


def test_outlines_are_read_as_rectangles_and_counted(tmp_path):
    triangle = "1 .1 .2 .5 .4 .3 .8"
    files = {"labels/1.txt": f"{YOLO_LINE}{triangle}\n{triangle} .7\n"}
    files |= {"labels/2.txt": "0 .5 .1 .9 .5 .5 .9 .1 .5", "data.yaml": NAMES}

    frames = read_source(write_files(tmp_path, files))
    for _ in range(2):  # the count is that of one reading
        first, second = frames
        (note,) = frames.notes()
        assert "3 outlines (polygons or rotated boxes) in 2 label files" in note

    assert annotation_of(first)["boxes"][0] == BOX
    shape = pytest.approx([0.3, 0.5, 0.4, 0.6])
    plain, sure = annotation_of(first)["boxes"][1:]
    assert plain == {"class": "van", "cxcywhn": shape}
    assert sure == {"class": "van", "cxcywhn": shape, "confidence": 0.7}
    (turned,) = annotation_of(second)["boxes"]
    assert turned["cxcywhn"] == pytest.approx([0.5, 0.5, 0.8, 0.8])


@pytest.mark.parametrize(
    ("behind", "more"),
    [("", {}), (".1 .2 2 .3 .4 2", {}), (".1 .2 2 .3 .4 2 .9", {"confidence": 0.9})],
)
def test_points_of_a_pose_are_no_outline(tmp_path, behind, more):
    files = {"data.yaml": f"{NAMES}\nkpt_shape: [2, 3]\n"}
    write_files(tmp_path, {**files, "labels/1.txt": f"{YOLO_LINE.strip()} {behind}"})

    frames = read_source(tmp_path)
    (frame,) = frames

    assert (frame.annotation, frames.notes()) == ({"boxes": [{**BOX, **more}]}, ())


@pytest.mark.parametrize(
    "behind",
    [
        ".9 1",  # the confidence and the number of a track
        ".45 .45 .55 .45",
        ".45 .45 1 .55 .45 1",
        ".45 .45 2 .55 .45 1",
        ".45 .45 1 .55 .45 1 .9",
    ],
)
def test_a_rectangle_with_numbers_behind_it_is_never_replaced(tmp_path, behind):
    lines = [f"0 .5 .5 .2 .2 {behind}", f"0 .1 .9 .05 .1 {behind}"]
    files = {f"labels/{n}.txt": line for n, line in enumerate(lines)}
    beyond = [f"0 .95 .5 .2 .2 {behind}", *[lines[0]] * 20]
    files["labels/9.txt"] = "\n".join(beyond)
    write_files(tmp_path, {**files, "data.yaml": NAMES})

    for frame in read_source(tmp_path):
        assert frame.problem is not None
        assert "kpt_shape" in frame.problem.detail
    points = len(behind.split())
    write_files(tmp_path, {"data.yaml": f"{NAMES}\nkpt_shape: [1, {points}]\n"})
    first, second, _ = [
        annotation_of(frame)["boxes"][0] for frame in read_source(tmp_path)
    ]
    assert first["cxcywhn"] == [0.5, 0.5, 0.2, 0.2]
    assert second["cxcywhn"] == [0.1, 0.9, 0.05, 0.1]


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        # As a rectangle one of them would lie beyond the image.
        (["0 .5 .5 .6 .5 .6 .6", "0 .8 .8 .9 .8 .9 .9"], ""),
        (["0 .5 .5 .6 .5 .6 .6 .5 .6", "0 .8 .8 .9 .8 .9 .9 .8 .9"], ""),
        # Polygons have different numbers of corners.
        (["0 .5 .5 .6 .5 .6 .6", "0 .5 .5 .6 .5 .6 .6 .5 .6"], ""),
        (["0 .5 .5 .6 .5 .6 .6"], "kpt_shape: [0, 2]\n"),
    ],
)
def test_outlines_are_told_from_rectangles_by_all_lines(tmp_path, lines, said):
    files = {f"labels/{n}.txt": line for n, line in enumerate(lines)}
    write_files(tmp_path, {**files, "data.yaml": f"{NAMES}{said}"})

    frames = read_source(tmp_path)
    boxes = [annotation_of(frame)["boxes"][0]["cxcywhn"] for frame in frames]

    assert boxes[0] == pytest.approx([0.55, 0.55, 0.1, 0.1])
    assert f"{len(lines)} outlines" in frames.notes()[0]


def test_sixth_column_is_confidence_and_any_line_ending_is_accepted(tmp_path):
    text = "\ufeff1 .5 .5 1e-1 .2 0.9\r\n\r\n0 0.5 0.5 0.1 0.2\r"
    write_files(tmp_path, {"labels/1.txt": text, "data.yaml": NAMES})

    (frame,) = read_source(tmp_path)

    first = {"class": "van", "cxcywhn": [0.5, 0.5, 0.1, 0.2], "confidence": 0.9}
    assert frame.annotation == {"boxes": [first, BOX]}


@pytest.mark.parametrize(
    "text",
    [
        "train: x\nnames: [car, 'street light']  # two\nnc: 2",
        "names:\n  - car\n  - street light\nnc: 2",
        'names:\n  0: car\n  1: "street light"\n\npath: .',
        "names: {0: car, 1: street light}",
        "names:\n  1: street light\n  0: car\n",
        "names: [\n  car,\n  street light,\n]",
    ],
)
def test_class_names_are_read_from_every_form_of_data_yaml(tmp_path, text):
    write_files(tmp_path, {"labels/1.txt": YOLO_LINE, "data.yaml": text})

    assert read_source(tmp_path).classes == ("car", "street light")


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"data.yaml": "names: {0: car, 2: van}"}, "expected numbers from 0 up"),
        ({"data.yaml": "names: car"}, "expected a list of class names"),
        ({"data.yaml": "names: [car, 3]"}, "expected a class name, found '3'"),
        ({"data.yaml": "nc: 2"}, "expected a list of class names"),
        ({"data.yaml": "names: [car"}, "data.yaml: line"),
        ({"data.yaml": "names: [a]\nnames: [b]"}, "given twice"),
        ({"label_2/1.txt": "", "frames.jsonl": '{"file": "", "key": "b"}'},
         "expected the name of a file, found ''"),
        ({"label/1.txt": "", "Readme.txt": '{"classes": {"car": [1]}}'},
         "Readme.txt: expected a number for each class, found a list"),
    ],
)  # fmt: skip
def test_list_with_an_invalid_name_or_number_is_refused(tmp_path, files, words):
    labels = {"labels/1.txt": YOLO_LINE} if "data.yaml" in files else {}
    write_files(tmp_path, labels | files)

    with pytest.raises(LayoutError) as caught:
        list(read_source(tmp_path))

    assert words in caught.value.detail


@pytest.mark.parametrize(
    ("layout", "options", "words"),
    [
        ("pairs", RecordingDescription(classes=("car",)),
         "layout 'pairs' has no option 'classes' (boxes.classes of a description); "
         "it has files, key, labels, segmentation"),
        ("pairs", RecordingDescription(default_class="car"),
         "no option 'default_class'"),
        ("coco", RecordingDescription(default_class="car"),
         "no option 'default_class'"),
        ("manifest", RecordingDescription(labels=Path("labels")), "no option 'labels'"),
    ],
)  # fmt: skip
def test_option_that_a_layout_does_not_use_is_refused(tmp_path, layout, options, words):
    with pytest.raises(LayoutError) as caught:
        read_source(tmp_path, layout, options)

    assert words in caught.value.detail


@pytest.mark.parametrize(
    ("layout", "files", "links"),
    [
        ("yolo", {"labels/2.txt": YOLO_LINE, "classes.txt": "car"},
         "images/1.png labels/1.txt data.yaml seg"),
        ("kitti", {"training/label_2/000002.txt": ""},
         "training/image_2 training/label_2/000001.txt"),
        ("voc", {"Annotations/2.xml": ""}, "Annotations/1.xml JPEGImages/1.png"),
        ("coco", {"2.json": EMPTY_COCO, "images/2.png": None},
         "annotations images/7.png annotations/.hidden.json"),
        ("carlasimu", {"label/2.txt": ""}, "cam cam/Readme.txt"),
        ("pairs", {"2.png": None}, "1.json a/1.PNG"),
    ],
)  # fmt: skip
def test_link_out_of_the_folder_is_refused_before_it_is_read(
    tmp_path, layout, files, links
):
    there = write_files(tmp_path / "elsewhere", {"label/1.txt": "", "1": ""})
    for number, link in enumerate(links.split()):
        town = write_files(tmp_path / f"{number}/town", files)
        (town / link).parent.mkdir(parents=True, exist_ok=True)
        (town / link).symlink_to(there / "1" if Path(link).suffix else there)

        with pytest.raises(LayoutError) as caught:
            read_source(town, layout)

        text = f'town: expected no link out of the folder, found "{link}"'
        assert caught.value.detail == f"{text}; {OUTSIDE_FILES_HINT}"


def test_coco_file_that_is_named_is_read_beside_links_out_of_its_folder(tmp_path):
    """Only the files of its frames must lie in the folder, which may be any folder."""
    sizes = {"width": 9, "height": 9}
    images = [{"id": n, "file_name": f"{n}.png", **sizes} for n in (1, 2)]
    content = json.dumps({**json.loads(EMPTY_COCO), "images": images})
    files = {"town/x.json": content, "town/1.png": None, "private.png": None}
    town = write_files(tmp_path, {**files, "all.json": EMPTY_COCO}) / "town"
    (town / "disk").symlink_to("/usr")
    (town / "2.png").symlink_to(tmp_path / "private.png")
    (town / "link.json").symlink_to(tmp_path / "all.json")
    outside = RecordingDescription(outside_files=True)

    good, bad = read_source(town / "x.json")
    _, allowed = read_source(town / "x.json", options=outside)

    assert (good.problem, good.image) == (None, town / "1.png")
    assert (bad.annotation, bad.image) == (None, None)
    assert 'found "2.png", a link out of it' in str(bad.problem)
    assert allowed.image == town / "2.png"
    assert keys(read_source(town / "link.json")) == []


def test_coco_file_that_is_a_link_out_of_the_folder_is_refused(tmp_path):
    write_files(tmp_path, {"all.json": EMPTY_COCO, "town/1.png": None})
    (tmp_path / "town/link.json").symlink_to(tmp_path / "all.json")

    with pytest.raises(LayoutError, match=r'found "link\.json"'):
        read_source(tmp_path / "town")


def test_links_inside_the_folder_into_named_folders_or_allowed_ones_are_read(tmp_path):
    files = {"town/labels/1.txt": YOLO_LINE, "town/raw/a.png": None, "tags/1.png": None}
    town = write_files(tmp_path, {**files, "town/data.yaml": NAMES}) / "town"
    (town / "images").mkdir()
    (town / "images/1.png").symlink_to("../raw/a.png")
    (town / "seg").symlink_to(tmp_path / "tags")
    (town / "notes").symlink_to(tmp_path / "notes")
    (town / ".cache").symlink_to("/usr")  # hidden: neither followed nor refused
    (tmp_path / "link").symlink_to(town)
    named = RecordingDescription(segmentation=town / "seg")

    (frame,) = read_source(tmp_path / "link", options=named)

    assert frame.image == tmp_path / "link/images/1.png"
    assert frame.segmentation == town / "seg/1.png"
    files = {"town/labels/1.txt": YOLO_LINE, "disk/1.png": None, "tags/1.png": None}
    town = write_files(tmp_path / "other", {**files, "town/data.yaml": NAMES}) / "town"
    (town / "1.png").symlink_to(tmp_path / "other/disk/1.png")
    (town / "seg").symlink_to(tmp_path / "tags")

    (frame,) = read_source(town, options=RecordingDescription(outside_files=True))

    assert frame.image == town / "1.png"
    assert frame.segmentation == town / "seg/1.png"


def test_link_that_leads_to_itself_ends_no_reading(tmp_path):
    town = write_files(tmp_path, {"1.png": None, "2.json": "{}"})
    (town / "again").symlink_to(town)
    (town / "1.json").symlink_to("1.json")

    assert keys(read_source(town)) == ["1"]


def test_carlasimu_layout_reads_widest_band_and_readme_class_numbers(tmp_path):
    images = ("cam/images/1.png", "cam/images_bbox/1.png", "seg/1.png")
    narrow = ("label50/1.txt", "label50/2.txt", "label100/1.txt")
    files = {
        "cam/Readme.txt": '{"classes": {"car": 1, "bus": 0}}',
        "cam/labels/label200/1.txt": "1 0.5 0.5 0.1 0.2",
        **dict.fromkeys(images),
        **{f"cam/labels/{name}": "" for name in narrow},
    }

    frames = read_source(write_files(tmp_path, files))
    (frame,) = frames

    assert (frames.layout, frames.classes) == ("carlasimu", ("bus", "car"))
    assert frame.annotation == {"boxes": [{**BOX, "distance_range": [100, 200]}]}
    assert frame.segmentation == tmp_path / "seg/1.png"
    assert [(file.path, file.why) for file in frames.unmatched] == [
        ("label50/2.txt", "not in the widest band, label200")
    ]
    # Without a class, rectangles are in pixels, and of the default class.
    raw = write_files(tmp_path / "raw", {"label/1.txt": "10 20 4 6\n"})
    write_files(raw, {"img/1.png": None})
    usual, named = RecordingDescription(), RecordingDescription(default_class="car")
    for options, name in ((usual, "unknown"), (named, "car")):
        (frame,) = read_source(raw, options=options)
        rectangle = {"cxcywh": [10.0, 20.0, 4.0, 6.0]}
        assert frame.annotation == {"boxes": [{"class": name, **rectangle}]}


@pytest.mark.parametrize("readme", ["# My data", '{"author": "me"}', "[1, 2]"])
def test_readme_without_classes_keeps_default_carlasimu_classes(tmp_path, readme):
    write_files(tmp_path, {"label/1.txt": "4 0.5 0.5 0.1 0.2", "Readme.txt": readme})

    (frame,) = read_source(tmp_path)

    assert frame.annotation == {"boxes": [{**BOX, "class": "walker"}]}


@pytest.mark.parametrize(
    ("files", "layout"),
    [
        ({"manifest.jsonl": "", "labels/1.txt": ""}, "manifest"),
        ({"labels/label50/1.txt": ""}, "carlasimu"),
        ({"out/label/1.txt": "", "out/img/1.png": None}, "carlasimu"),
        ({"label/1.txt": "", "Readme.txt": "{}"}, "carlasimu"),
        ({"label/1.txt": "", "images/1.png": None, "data.yaml": NAMES}, "yolo"),
        ({"labels/1.txt": "", "data.yaml": NAMES}, "yolo"),
        ({"Annotations/1.xml": ""}, "voc"),
        ({"Annotations/1.xml": "", "ImageSets/Main/train.txt": "1\n"}, "voc"),
        ({"training/label_2/000001.txt": ""}, "kitti"),
        ({"label_2/000001.txt": "", "ImageSets/train.txt": "000001"}, "kitti"),
        ({"annotations/instances_val.json": EMPTY_COCO, "images/1.png": None}, "coco"),
        ({"any.json": EMPTY_COCO, "package.json": "[]", "other.json": "{}"}, "coco"),
        ({"1.png": None, "notes.md": "", "readme.txt": ""}, "pairs"),
        ({"run/frames.7.jsonl": "", "1.png": None}, "manifest"),
        ({"a.jsonl": "", "labels/1.txt": "", "data.yaml": NAMES}, "yolo"),
        ({"frames.jsonl": "", "1.png": None}, "pairs"),
        ({"a.jsonl": "", "b.jsonl": "", "1.png": None}, "pairs"),
    ],
)
def test_a_layout_is_recognised_by_its_files(tmp_path, files, layout):
    assert detect_layout(write_files(tmp_path, files)) == layout


def test_layout_detection_has_a_fixed_precedence(tmp_path):
    """A manifest comes first, then KITTI's folders, then carlasimu's."""
    undecided = {"a.xml": "", "a.txt": "", "data.yaml": NAMES, "a.json": EMPTY_COCO}
    write_files(tmp_path, undecided)
    with pytest.raises(LayoutError, match="could be voc or yolo or coco;"):
        detect_layout(tmp_path)
    for file, layout in (
        ("labels/label50/a.txt", "carlasimu"),
        ("label_2/a.txt", "kitti"),
        ("manifest.jsonl", "manifest"),
    ):
        write_files(tmp_path, {file: ""})
        assert detect_layout(tmp_path) == layout


def test_yolo_labels_without_class_names_are_refused_unless_they_are_given(tmp_path):
    """Images with such labels have no layout unless it is named."""
    write_files(tmp_path, {"images/1.png": None, "labels/1.txt": YOLO_LINE})

    assert possible_layouts(tmp_path) == ()
    with pytest.raises(LayoutError, match="no layout recognised") as caught:
        read_source(tmp_path)
    assert caught.value.detail.endswith(
        "; found labels/1.txt, which may be a label of YOLO, but no list of its "
        "classes in data.yaml, data.yml, dataset.yaml, classes.txt, labels.txt or "
        "obj.names"
    )
    assert keys(read_source(tmp_path, "pairs")) == ["1"]
    with pytest.raises(LayoutError, match=r"data\.yaml"):
        read_source(tmp_path, "yolo")
    named = read_source(tmp_path, "yolo", RecordingDescription(classes=("car",)))
    assert [frame.annotation for frame in named] == [{"boxes": [BOX]}]


def test_folder_above_manifests_is_read_if_there_is_one(tmp_path):
    files = {"a/rgb/1.png": None, "a/truth.jsonl": "{}"}
    write_files(tmp_path, {**files, "a/manifest.jsonl": '{"key": "a"}'})

    frames = read_source(tmp_path)
    write_files(tmp_path, {"b/manifest.jsonl": "{}", "b/depth/1.png": None})

    assert (frames.layout, keys(frames)) == ("manifest", ["a"])
    with pytest.raises(LayoutError) as caught:
        read_source(tmp_path)
    assert caught.value.detail == (
        f"{tmp_path.name}: expected one manifest.jsonl, found 2; give the folder of "
        "one of them, such as a"
    )


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("1.png", "1.png: no layout recognised"),
        ("voc.zip", "found a ZIP archive; unpack it first"),
        ("nowhere", "nowhere"),
    ],
)
def test_source_that_is_no_folder_is_refused_without_its_parent_path(
    tmp_path, name, words
):
    write_files(tmp_path, {"1.png": None})
    with ZipFile(tmp_path / "voc.zip", "w") as archive:
        archive.writestr("Annotations/1.xml", "<annotation/>")

    with pytest.raises(LayoutError) as caught:
        read_source(tmp_path / name)

    assert words in caught.value.detail
    assert str(tmp_path) not in caught.value.detail


def test_folder_or_file_that_cannot_be_read_says_what_was_expected(tmp_path):
    for layout, words in [
        ("auto", "no layout recognised"),
        ("ylo", "the nearest is 'yolo'"),
        ("coco", "images, annotations and categories"),
        ("kitti", "found neither"),
        ("manifest", r"expected manifest\.jsonl"),
        ("carlasimu", "found neither"),
    ]:
        with pytest.raises(LayoutError, match=words):
            read_source(tmp_path, layout)
    write_files(tmp_path, {"labels/1.txt": b"\xff\xfe0", "data.yaml": NAMES})
    (frame,) = read_source(tmp_path)
    assert "labels/1.txt: expected UTF-8 text, found byte 0xff" in str(frame.problem)


OF_KITTI = {f"training/{name}/000001.txt": "" for name in ("label_2", "calib")}
OF_KITTI_WITH_PICTURE = {**OF_KITTI, "training/image_2/000001.png": None}


@pytest.mark.parametrize(
    ("layout", "pipe", "files"),
    [
        ("yolo", "labels/1.txt", {"images/1.png": None, "classes.txt": "car"}),
        ("voc", "Annotations/1.xml", {"JPEGImages/1.png": None}),
        ("kitti", "training/label_2/000001.txt", OF_KITTI_WITH_PICTURE),
        ("kitti", "training/image_2/000001.png", OF_KITTI_WITH_PICTURE),
        ("carlasimu", "label/1.txt", {"cam/1.png": None}),
        ("pairs", "1.json", {"1.png": None}),
    ],
)
def test_pipe_in_place_of_a_file_is_the_problem_of_its_frame(
    tmp_path, layout, pipe, files
):
    town = write_files(tmp_path / "town", files)
    (town / pipe).parent.mkdir(exist_ok=True)
    (town / pipe).unlink(missing_ok=True)
    os.mkfifo(town / pipe)

    (frame,) = read_source(town, layout)

    assert frame.problem is not None
    assert "cannot be read: not a regular file" in frame.problem.detail
    assert str(tmp_path) not in frame.problem.detail


def test_pipe_that_is_named_like_a_coco_file_is_ignored(tmp_path):
    town = write_files(tmp_path / "town", {"a.json": EMPTY_COCO})
    os.mkfifo(town / "b.json")

    assert read_source(town, "coco").count == 0


def test_overlong_label_is_refused(tmp_path):
    label = tmp_path / "a.txt"
    label.write_bytes(b" " * MAX_LABEL_BYTES)
    assert len(read_label_bytes(label, "a.txt")) == MAX_LABEL_BYTES
    os.truncate(label, MAX_LABEL_BYTES + 1)

    with pytest.raises(LayoutError, match=f"expected at most {MAX_LABEL_BYTES} bytes"):
        read_label_bytes(label, "a.txt")


def test_label_that_is_an_endless_device_is_refused_without_reading_it(tmp_path):
    town = write_files(tmp_path / "town", {"images/1.png": None, "classes.txt": "car"})
    (town / "labels").mkdir()
    (town / "labels" / "1.txt").symlink_to("/dev/zero")

    (frame,) = read_source(town, "yolo", RecordingDescription(outside_files=True))

    assert "not a regular file" in str(frame.problem)


def test_cvat_is_read_with_parts_attributes_and_outlines(tmp_path):
    write_files(tmp_path, LAYOUT_FILES["cvat"])

    recording = read_source(tmp_path)
    (frame,) = recording

    assert (recording.layout, recording.classes) == ("cvat", ("car",))
    assert recording.unmatched == ()
    assert (frame.key, frame.image) == ("a/1", tmp_path / "images/a/1.png")
    first, second, third = annotation_of(frame).pop("boxes")
    assert frame.annotation == {"camera": {"width": 80, "height": 60}, "split": "valid"}
    car = {"class": "car", "xyxy": [1.0, 2.0, 10.5, 20.0], "occluded": 1}
    assert first == {**car, "attributes": {"colour": "red"}}
    assert second["xyxy"] == pytest.approx([20, 20, 30, 30])
    assert third == {"class": "bus", "xyxy": [1.5, 2.0, 10.0, 8.25], "occluded": 0}
    assert [note[0] for note in recording.notes()[:3]] == ["1"] * 3


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("<track></track>", "found tracks of CVAT for video"),
        ('<image name="a.png"><box label="car" xtl="x"/></image>', "a finite number"),
        ('<image name="a.png"><box xtl="1" ytl="1" xbr="2" ybr="2"/></image>', "label"),
        ('<image name="a.png"><polygon label="a" points="1"/></image>', "x,y;x,y"),
        ('<image name="a.png" xmlns:a="b"/>', "expected no namespaces"),
        ("<image>", "cannot be read as XML"),
    ],
)
def test_fault_of_a_cvat_file_is_named(tmp_path, content, words):
    text = f"<annotations><version>1.1</version>{content}</annotations>"
    write_files(tmp_path, {"a.xml": text, "a.png": b""})

    with pytest.raises(FilterError) as caught:
        measure_source(next(iter(read_source(tmp_path))), FilterConfig(), ())

    assert caught.value.detail.startswith("a.xml")
    assert words in caught.value.detail


@pytest.mark.parametrize("layout", ["label-studio", "cvat"])
def test_id_or_size_that_is_none_is_left_out(tmp_path, layout):
    value = {"x": 10, "y": 20, "width": 20, "height": 20}
    region = {"id": [1], "original_width": 10, "original_height": 10, "value": value}
    tasks = [{"data": {"image": "1.png"}, "annotations": [{"result": [region]}]}]
    box = "<box label='unknown' xtl='1' ytl='2' xbr='3' ybr='4'/>"
    image = f"<image name='1.png' height='6' width='{'9' * 5000}'>{box}</image>"
    cvat = f"<annotations><version>1.1</version>{image}</annotations>"
    labels = {"a.xml": cvat} if layout == "cvat" else {"a.json": json.dumps(tasks)}
    write_files(tmp_path, {**labels, "1.png": b""})

    (frame,) = read_source(tmp_path)

    (box,) = annotation_of(frame)["boxes"]
    assert box == {"class": "unknown", "xyxy": [1, 2, 3, 4]}


def test_label_studio_is_read_as_the_annotation_in_force(tmp_path):
    files = {**LAYOUT_FILES["label-studio"], "images/2.png": b""}
    unlabelled = {"id": 13, "data": {"image": "2.png"}, "annotations": []}
    data = {"image": "http://host/größe.png", "key": "b/3", "split": "val"}
    predicted = {"id": 14, "data": data, "annotations": []}
    predicted["predictions"] = [{"result": []}]
    content = json.dumps([TASK, unlabelled, predicted], ensure_ascii=False)
    write_files(tmp_path, {**files, "tasks.json": content, "images/größe.png": b""})

    recording = read_source(tmp_path)
    frame, other = recording

    assert (recording.layout, other.key) == ("label-studio", "b/3")
    assert other.image == tmp_path / "images/größe.png"
    assert other.annotation == {"split": "val", "boxes": []}
    assert (frame.key, frame.image) == ("1", tmp_path / "images/1.png")
    boxes = annotation_of(frame).pop("boxes")
    assert frame.annotation == {"camera": {"width": 80, "height": 60}}
    assert boxes == [
        {"class": "car", "xyxy": [10.0, 30.0, 30.0, 36.0], "id": "r1"},
        {"class": "bus", "xyxy": [8.0, 6.0, 40.0, 54.0], "id": "p1"},
    ]
    whys = [file.why for file in recording.unmatched]
    assert whys == ["no task lists this image", "task 13: not labelled yet"]
    assert [note[0] for note in recording.notes()[:3]] == ["1"] * 3


def test_turned_rectangle_of_label_studio_is_read_as_the_one_around_it(tmp_path):
    value = {"x": 50, "y": 50, "width": 10, "height": 20, "rotation": 90}
    region = {"id": "a", "type": "rectanglelabels", "original_width": 200}
    region |= {"original_height": 100, "value": {**value, "rectanglelabels": ["car"]}}
    task = {"data": {"image": "1.png"}, "annotations": [{"result": [region]}]}
    write_files(tmp_path, {"tasks.json": json.dumps([task]), "1.png": b""})

    (frame,) = read_source(tmp_path)

    # 20 by 20 px, turned to the left of its first corner at (100, 50).
    assert annotation_of(frame)["boxes"][0]["xyxy"] == pytest.approx([80, 50, 100, 70])


def test_decisions_are_read_with_the_answers_of_people(tmp_path):
    write_files(tmp_path, LAYOUT_FILES["decisions-jsonl"])

    recording = read_source(tmp_path)
    (frame,) = recording

    assert recording.layout == "decisions-jsonl"
    assert frame.image == tmp_path / "images/a/1.png"
    boxes = annotation_of(frame).pop("boxes")
    assert boxes == [{"id": "7", "class": "car", "xyxy": [1, 2, 3, 4]}]
    assert frame.annotation == {"camera": {"width": 80, "height": 60}, "split": "valid"}
    assert frame.answers == [("7", "reject", "ann", "no car", "2026-01-01T00:00:00Z")]
    assert "1 boxes have no rectangle" in recording.notes()[0]
