"""The files of each export format follow the format's own specification exactly."""

import json

import defusedxml.ElementTree as ElementTree
import pytest
import yaml

from filter_core.formats.files import number_text
from filter_core.formats.kitti import kitti_types
from filter_core.formats.voc import whole_pixels
from tests.support.exporting import HEAD, box, export, frame, labels_of

COCO_TRAIN = "annotations/instances_train.json"
POSE = {"x": 1, "y": 0, "z": 2, "pitch": 0, "yaw": 0, "roll": 0}
CLIPPED = box("cut", (-10, 20, 30, 60), amodal_xyxy=[-10, 20, 30, 60])
GHOST = box("ghost", (50, 10, 70, 30), "rejected")


def document(files, name):
    return json.loads(files[name])


def elements(files, name):
    return ElementTree.fromstring(files[name].decode())


def test_coco_export_has_ids_from_one_and_xywh_boxes():
    walker = box(1, class_name="walker")
    files = export("coco", [frame("a/7", box(0), walker), frame("b", CLIPPED)], split=1)
    made = document(files, COCO_TRAIN)

    categories = [(category["id"], category["name"]) for category in made["categories"]]
    assert categories == [*enumerate(HEAD.classes, 1)]
    images = [(image["id"], image["file_name"]) for image in made["images"]]
    assert images == [(1, "a/7.png"), (2, "b.png")]
    keys = ("id", "image_id", "category_id", "bbox", "area", "iscrowd", "segmentation")
    rows = [tuple(row[key] for key in keys) for row in made["annotations"]]
    assert rows == [
        (1, 1, 1, [10.0, 20.0, 20.0, 40.0], 800.0, 0, []),
        (2, 1, 3, [10.0, 20.0, 20.0, 40.0], 800.0, 0, []),
        (3, 2, 1, [0.0, 20.0, 30.0, 40.0], 1200.0, 0, []),
    ]
    assert document(files, "annotations/instances_val.json")["images"] == []


def test_coco_export_keeps_keys_of_the_input_but_no_outline_of_another_rectangle():
    outline = [[1, 2, 3, 4, 5, 6]]
    fields = {"area": 17.5, "ignore": 0, "track": 3, "segmentation": outline}
    files = export("coco", [frame("a", box("x", given=fields, distance=12.5))], split=1)

    (row,) = document(files, COCO_TRAIN)["annotations"]

    assert {key: row[key] for key in fields} == fields
    assert row["attributes"] == {"id": "x", "distance": 12.5}
    corners = [[float(n), 0.0, 1.0] for n in range(8)]
    camera = {"width": 100, "height": 80, "fov": 90.0, "transform": POSE}
    solid = box(0, given={"vertices": corners})

    files = export("coco", [frame("a", solid, annotation={"camera": camera})], split=1)
    made = document(files, COCO_TRAIN)

    assert made["annotations"][0]["attributes"]["vertices"] == corners
    assert made["images"][0]["camera"] == camera
    outline = [[0, 0, 90, 0, 90, 70, 0, 70]]
    fields = {"xyxy": [0, 0, 90, 70], "area": 6300.0, "segmentation": outline}
    tight = box(0, (0, 0, 90, 70), given=fields, tight_xyxy=[10, 10, 30, 30])

    for boxes, seen in (("visible", (6300.0, outline)), ("tight", (400.0, []))):
        files = export("coco", [frame("a", tight)], split=1.0, boxes=boxes)
        (row,) = document(files, COCO_TRAIN)["annotations"]
        assert (row["area"], row["segmentation"]) == seen


@pytest.mark.parametrize(
    ("name", "file", "says"),
    [
        ("coco", "annotations/instances_train.json", b'"iscrowd":1'),
        ("kitti", "training/label_2/000000.txt", b"DontCare -1 -1 -10.00 50.00 10.00"),
        ("voc", "Annotations/a.xml", b"<difficult>1</difficult>"),
    ],
)
def test_rejected_boxes_are_exported_as_dontcare_regions(name, file, says):
    frames = [frame("a", box(0), GHOST)]

    ignored = export(name, frames, split=1.0, rejected="dontcare")
    dropped = export(name, frames, split=1.0)

    assert says in ignored[file]
    assert says not in dropped[file]
    counts = document(ignored, "manifest.json")["counts"]["boxes"]
    assert (counts["out"], counts["dontcare"], counts["dropped"]) == (1, 1, 0)


def test_kitti_export_has_15_columns_and_defaults_for_unknown_values():
    frames = [frame("x/y z", box(0), CLIPPED, box(1, occluded=2))]
    files = export("kitti", frames, split=1.0)

    rest = "60.00 -1.00 -1.00 -1.00 -1000.00 -1000.00 -1000.00 -10.00"
    assert files["training/label_2/000000.txt"].decode().splitlines() == [
        f"car 0.00 3 -10.00 10.00 20.00 30.00 {rest}",
        f"car 0.25 3 -10.00 0.00 20.00 30.00 {rest}",
        f"car 0.00 2 -10.00 10.00 20.00 30.00 {rest}",
    ]
    assert files["ImageSets/train.txt"] == b"000000\n"
    assert json.loads(files["frames.jsonl"])["key"] == "x/y z"
    # Any sender may use these keys, so their values need not be KITTI's.
    fields = {"kitti": {"alpha": "north", "dimensions": ["a", "b", "c"]}}
    beside = {"dontcare": [["left", "top", "right", "bottom"], [1, 2, 3, 4]]}
    made = frame("a", box(0, given=fields), annotation=beside)

    files = export("kitti", [made], split=1.0)

    car, region = files["training/label_2/000000.txt"].decode().splitlines()
    assert car.split()[3] == "-10.00"
    assert region.startswith("DontCare -1 -1 -10.00 1.00 2.00 3.00 4.00 ")


def test_kitti_types_are_unique_and_without_spaces():
    classes = ("traffic light", "traffic_light", "dontcare", "Car", "car")
    types = ("traffic_light", "traffic_light_2", "dontcare_2", "Car", "car")

    assert kitti_types(classes) == dict(zip(classes, types, strict=True))
    made = export("kitti", [frame("a", box(0, class_name="traffic light"))])
    assert made["training/label_2/000000.txt"].split()[0] == b"traffic_light"
    said = document(made, "manifest.json")["kitti_types"]
    assert said == {"traffic light": "traffic_light"}


def test_yolo_export_has_no_label_like_a_list_of_classes_and_no_empty_part():
    files = export("yolo", [frame("classes", box(0))], split=1.0)

    labels = [name for name in files if name.startswith("labels/")]
    assert len(labels) == 1
    assert not labels[0].endswith("/classes.txt")
    names = yaml.safe_load(export("yolo", [frame("a")], split=0.0)["data.yaml"])

    assert (names["train"], names["val"]) == ("images/val", "images/val")


@pytest.mark.parametrize(
    ("value", "text"),
    [(1, "1.00"), (1.5, "1.50"), (0.125, "0.125"), (-1e-9, "0.00"), (2.00004, "2.00")],
)
def test_kitti_numbers_have_two_decimals_at_least(value, text):
    assert number_text(value) == text


@pytest.mark.parametrize(
    ("xyxy", "voc"),
    [
        ((0, 0, 100, 80), [1, 1, 100, 80]),
        ((0, 0, 1, 1), [1, 1, 1, 1]),
        ((10.4, 20.6, 30.5, 60.49), [11, 22, 31, 60]),
        ((99.7, 79.7, 100, 80), [100, 80, 100, 80]),
        ((50.2, 50.2, 50.3, 50.3), [51, 51, 51, 51]),
    ],
)
def test_voc_export_uses_integer_pixels_from_one(xyxy, voc):
    assert whole_pixels(xyxy, (100, 80)) == voc


def test_voc_export_has_a_file_per_image_and_flags_of_0_or_1():
    fields = {"pose": "Left", "difficult": 1, "occluded": 1}
    flags = {"truncated": True, "difficult": 0.35, "occluded": None, "pose": {"x": 1}}
    boxes = [box(0, given=fields), CLIPPED, box(1, given=flags)]
    files = export("voc", [frame("a", *boxes), frame("b/c")], split=1.0)

    root = elements(files, "Annotations/a.xml")
    keys = ("pose", "truncated", "difficult", "occluded")
    assert [[row.findtext(key) for key in keys] for row in root.iter("object")] == [
        ["Left", "0", "1", "1"],
        ["Unspecified", "1", "0", "0"],
        ["Unspecified", "1", "0", "0"],
    ]
    assert root.findtext("size/depth") == "3"
    assert not list(elements(files, "Annotations/b__c.xml").iter("object"))
    assert files["ImageSets/Main/train.txt"] == b"a\nb__c\n"
    assert files["JPEGImages/b__c.png"].startswith(b"\x89PNG")


def test_cvat_export_contains_verdict_and_reason_of_each_box():
    files = export("cvat", [frame("a<b", CLIPPED, GHOST)], include="all")
    root = elements(files, "annotations.xml")

    assert root.findtext("version") == "1.1"
    assert [each.findtext("name") for each in root.iter("label")] == list(HEAD.classes)
    (image,) = root.iter("image")
    size = {"width": "100", "height": "80"}
    assert image.attrib == {"id": "0", "name": "a%3Cb.png", "subset": "train", **size}
    first, second = image.iter("box")
    corners = [first.attrib[key] for key in ("xtl", "ytl", "xbr", "ybr")]
    assert corners == ["0.00", "20.00", "30.00", "60.00"]
    said = {row.attrib["name"]: row.text for row in second.iter("attribute")}
    assert said == {"id": "ghost", "verdict": "rejected", "reason": "below_threshold"}


def test_label_studio_has_the_whole_labelling_and_what_the_filter_says():
    review = {"review": {"verdict": "keep"}, "effective_verdict": "kept"}
    person = box("p", verdict="rejected", **review)
    ghosts = frame("done", box(0, verdict="rejected"))
    frames = [frame("a b", box(0, match_percent=40.0), person), ghosts]

    files = export("label-studio", frames)
    task, done = document(files, "tasks.json")

    # A frame without an annotation would not be labelled yet.
    assert [annotation["result"] for annotation in done["annotations"]] == [[]]

    assert task["data"]["image"] == "/data/local-files/?d=images/a%20b.png"
    (prediction,) = task["predictions"]
    assert prediction["model_version"] == "unghost-000000000000"
    (region,) = prediction["result"]
    assert (region["score"], region["id"]) == (0.4, "0")
    percent = {"x": 10.0, "y": 25.0, "width": 20.0, "height": 50.0}
    assert region["value"] == {**percent, "rotation": 0, "rectanglelabels": ["car"]}
    (annotation,) = task["annotations"]
    people = {box["id"]: box["origin"] for box in annotation["result"]}
    assert people == {"0": "prediction", "p": "manual"}
    labels = elements(files, "label_config.xml").iter("Label")
    assert [label.attrib["value"] for label in labels] == list(HEAD.classes)


def test_manifest_export_returns_the_input_without_rejected_boxes():
    fields = {"id": "7", "cxcywhn": [0.5, 0.5, 0.1, 0.1], "mine": {"deep": [1]}}
    kept = box("7", given=fields)
    own = {"weather": {"fog_density": 2.0}, "mine": 1}
    annotation = {**own, "boxes": ["all of them"]}
    files = export("manifest", [frame("a/b", kept, GHOST, annotation=annotation)])

    line = json.loads(files["manifest.jsonl"])

    named = {"key": "a/b", "image": "images/a/b.png"}
    assert line == {**named, **own, "boxes": [kept.given]}
    assert files["images/a/b.png"].startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("name", "file", "mark"),
    [
        ("yolo", "{band}/train/a.txt", b"\n"),
        ("voc", "{band}/a.xml", b"<object>"),
        ("kitti", "training/{band}/000000.txt", b"\n"),
        ("coco", "annotations/{band}/instances_train.json", b'"bbox"'),
    ],
)
def test_distance_bands_contain_near_and_unknown_distance_boxes(name, file, mark):
    boxes = [box(0, distance=49.9), box(1, distance=50.1), box(2, distance=None)]
    files = export(name, [frame("a", *boxes)], split=1.0, bands=[100, 50])

    for band, count in (("label50", 2), ("label100", 3)):
        assert files[file.format(band=band)].count(mark) == count
    bands = document(files, "manifest.json")["counts"]["bands"]
    assert bands == {"label50": 2, "label100": 3}
    near = file.format(band="label50")
    assert export(name, [frame("a", *boxes)], split=1.0, bands=50)[near] == files[near]


def test_missing_tight_rectangle_falls_back_to_visible_and_is_counted():
    tight = box(0, tight_xyxy=[12, 22, 28, 58])
    files = export("coco", [frame("a", tight, box(1))], split=1.0, boxes="tight")

    made = document(files, COCO_TRAIN)["annotations"]

    assert [row["bbox"][:2] for row in made] == [[12.0, 22.0], [10.0, 20.0]]
    counts = document(files, "manifest.json")["counts"]
    assert counts["rectangles"] == {"tight": 1, "visible": 1}
    assert counts["boxes"]["clipped"] == 0


def test_crowd_box_is_dropped_by_formats_without_crowds():
    frames = [frame("a", box(0, given={"iscrowd": 1}))]
    yolo, coco = (export(name, frames, split=1.0) for name in ("yolo", "coco"))

    assert yolo["labels/train/a.txt"] == b""
    counts = document(yolo, "manifest.json")["counts"]
    assert counts["not_kept_by_reason"] == {"crowd": 1}
    (row,) = document(coco, COCO_TRAIN)["annotations"]
    assert row["iscrowd"] == 1


OWN_LINES = (
    "car 0.10 1 1.57 10.00 20 30 60.0 1.5 1.6 4 1 2 20 0.1\n",
    "DontCare -1 -1 -10 1.50 2 3 4 -1 -1 -1 -1000 -1000 -1000 -10\n",
    "car 0 0 0 50 10 70 30 1.5 1.6 4 1 2 20 0.1\n",
)
OWN_XML = (
    "<annotation><filename>x/a.png</filename>\n<object><name>car</name><bndbox>"
    "<xmin>11</xmin><ymin>21</ymin><xmax>30</xmax><ymax>60</ymax></bndbox></object>",
    "\n<object><name>car</name><mine/><bndbox><xmin>51</xmin><ymin>11</ymin>"
    "<xmax>70</xmax><ymax>30</ymax></bndbox></object>",
    "\n</annotation>",
)
OWN_SHARES = ("0 0.2 0.50 0.200 0.5 0.9 \n", "0 0.6 0.25 0.2 0.25")
OWN_TEXT = {
    form: "".join(parts)
    for form, parts in {"kitti": OWN_LINES, "voc": OWN_XML, "yolo": OWN_SHARES}.items()
}
OWN_FILE = {
    "kitti": "training/label_2/000007.txt",
    "voc": "Annotations/a.xml",
    "yolo": "labels/train/a.txt",
}


def came_as(name, key="a", class_name="car", **stored):
    """A frame with a car and a ghost that came with a label file."""
    labels = {"format": name, "file": "000007.txt", "text": OWN_TEXT[name], **stored}
    boxes = [box(0, class_name=class_name), box(1, (50, 10, 70, 30), "rejected")]
    if name == "yolo":
        for each, shares in zip(boxes, OWN_SHARES, strict=True):
            del each.given["xyxy"]
            each.given["cxcywhn"] = list(map(float, shares.split()[1:5]))
    return frame(key, *boxes, annotation={"source_labels": labels})


@pytest.mark.parametrize(
    ("name", "left"),
    [
        ("kitti", "".join(OWN_LINES[:2])),
        ("voc", OWN_XML[0] + OWN_XML[2]),
        ("yolo", OWN_SHARES[0]),
    ],
)
def test_labels_that_came_in_the_format_are_written_as_they_came(name, left):
    files = export(name, [came_as(name)], split=1)

    assert files[OWN_FILE[name]].decode() == left


def test_kitti_export_writes_own_lines_with_the_present_class_and_numbers():
    walker = came_as("kitti", "b", class_name="walker")
    frames = [came_as("kitti", "a"), walker, frame("c", box(0))]

    files = export("kitti", frames, split=1, rejected="dontcare")

    labels = {
        name.rpartition("/")[2]: content.decode().splitlines(keepends=True)
        for name, content in files.items()
        if name.startswith("training/label_2/")
    }
    renamed = OWN_LINES[0].replace("car", "walker")
    assert labels["000007.txt"][:2] == [OWN_LINES[0], OWN_LINES[1]]
    assert labels["000000.txt"][:2] == [renamed, OWN_LINES[1]]
    assert labels["000007.txt"][2].startswith("DontCare -1 -1 -10.00 50.00 10.00")
    assert sorted(labels) == ["000000.txt", "000001.txt", "000007.txt"]
    assert files["ImageSets/train.txt"] == b"000007\n000000\n000001\n"
    assert "training/image_2/000007.png" in files


@pytest.mark.parametrize("name", OWN_FILE)
@pytest.mark.parametrize(
    "changed",
    [
        {"text": 7},
        {"text": ""},
        {"text": "\0 <"},
        {"text": "<annotation>\ud800</annotation>"},
        {"text": "car 1 2 three"},
        {"format": "other"},
        {"file": None},
    ],
)
def test_other_labels_than_those_of_the_boxes_are_not_written(name, changed):
    plain = came_as(name)
    plain.given.frame.pop("source_labels")
    other = came_as(name)
    other.given.frame["source_labels"].update(changed)

    files = [export(name, [frame]) for frame in (plain, other)]

    assert labels_of(files[0]) == labels_of(files[1])
    assert "frames_as_they_came" not in document(files[1], "manifest.json")


def test_coco_export_has_own_ids_where_they_are_different():
    person = {"id": 90, "name": "walker", "supercategory": "person"}
    stored = {"format": "coco", "image_id": 7, "categories": {"walker": person}}
    fields = {"id": "31", "xywh": [10, 20.0, 20, 40], "track": 3}
    frames = [
        frame(key, walker, annotation={"source_labels": stored})
        for key in ("a", "b")
        for walker in [box(31, class_name="walker", given=dict(fields))]
    ]

    files = export("coco", [*frames, frame("c", box(0))], split=1)
    written = document(files, COCO_TRAIN)

    assert [image["id"] for image in written["images"]] == [7, 1, 2]
    first, second, third = written["annotations"]
    ids = {"id": 31, "image_id": 7, "category_id": 90}
    assert first == {**ids, "bbox": [10, 20.0, 20, 40], "track": 3}
    assert (second["id"], second["image_id"], third["id"]) == (1, 1, 2)
    assert [category["id"] for category in written["categories"]] == [1, 2, 90]
    assert written["categories"][2]["supercategory"] == "person"
    assert "source_labels" not in written["images"][0]
