"""Exports of YOLO and of decisions: files, chosen boxes, counts and safe names."""

import json

import pytest
import yaml

from filter_core.formats.export import ExportError, ExportHead, ExportOptions
from filter_core.formats.files import file_stem
from filter_core.formats.registry import EXPORT_FORMATS, FORMATS, write_export
from filter_core.formats.writing import split_of
from tests.support import exporting

HEAD = ExportHead(("car", "traffic light"), {"dataset": "d", "config": "0" * 64})


def box(number, verdict="kept", xyxy=(10, 20, 30, 60), **more):
    return exporting.box(number, xyxy, verdict, **more)


def frame(key, *boxes, **more):
    return exporting.frame(key, *boxes, **{"map": "Town01", "read_image": None, **more})


def export(frames, head=HEAD, **options):
    """The files that the YOLO writer makes, by name."""
    files = {}

    def sink(name, pieces):
        assert name not in files
        files[name] = b"".join(pieces)

    write_export("yolo", iter(frames), sink, head, ExportOptions(**options))
    return files


def manifest_of(files):
    return json.loads(files["manifest.json"])


def in_out_counts(counts):
    """How many boxes came in and out, were dropped and were clipped."""
    return tuple(counts[name] for name in ("in", "out", "dropped", "clipped"))


def test_yolo_export_writes_image_and_label_of_the_same_name():
    frames = [frame("a/7", box(0), read_image=lambda: b"PNG"), frame("7")]
    files = export(frames, allow_missing_images=True)

    part = split_of("a/7", "Town01", 0.8)
    assert files[f"images/{part}/a__7.png"] == b"PNG"
    line = files[f"labels/{part}/a__7.txt"].decode()
    assert line == "0 0.200000000 0.500000000 0.200000000 0.500000000\n"
    assert files[f"labels/{split_of('7', 'Town01', 0.8)}/7.txt"] == b""
    counts = manifest_of(files)["counts"]["frames"]
    assert (counts["in"], counts["without_boxes"]) == (2, 1)


def test_data_yaml_has_train_val_and_names_in_order_and_no_path():
    document = yaml.safe_load(export([])["data.yaml"])

    assert document == {
        "train": "images/train",
        "val": "images/val",
        "names": {0: "car", 1: "traffic light"},
    }


def test_boxes_are_clipped_before_they_are_normalised():
    amodal = box(0, xyxy=(80, 0, 100, 40), amodal_xyxy=[80, -40, 140, 40])

    files = export([frame("7", amodal)], split=(1.0,), images="none", boxes="amodal")

    text = files["labels/train/7.txt"].decode()
    assert text == "0 0.900000000 0.250000000 0.200000000 0.500000000\n"
    (row,) = manifest_of(files)["boxes"]
    fate = {"fate": "clipped", "reason": "beyond_image"}
    assert row == {"frame": "7", "box": "0", "class": "car", **fate}
    cut = box(0, xyxy=(0, 0, 30, 60), given={"xyxy": [-5, -5, 30, 60]})

    counts = manifest_of(export([frame("7", cut)], images="none"))["counts"]

    assert in_out_counts(counts["boxes"]) == (1, 1, 0, 1)


REJECTED_BY_PERSON = {"review": {"verdict": "reject"}, "effective_verdict": "rejected"}
KEPT_BY_PERSON = {"review": {"verdict": "keep"}, "effective_verdict": "kept"}


@pytest.mark.parametrize(
    ("options", "out"),
    [
        ({}, ["0", "3", "4"]),
        ({"include": "kept"}, ["0", "2", "4", "5"]),
        ({"include": "all"}, ["0", "1", "2", "3", "4", "5"]),
        ({"include": "all", "include_unmeasured": False}, list("012345")),
    ],
)
def test_include_options_select_the_exported_boxes(options, out):
    boxes = [
        box(0),
        box(1, "rejected"),
        box(2, **REJECTED_BY_PERSON),
        box(3, "rejected", **KEPT_BY_PERSON),
        box(4, "unmeasured"),
        box(5, "unmeasured", **REJECTED_BY_PERSON),
    ]

    files = export([frame("7", *boxes)], split=(1.0,), images="none", **options)

    dropped = [row["box"] for row in manifest_of(files)["boxes"]]
    assert sorted(dropped + out) == ["0", "1", "2", "3", "4", "5"]
    assert files["labels/train/7.txt"].count(b"\n") == len(out)


SELECTING = [n for n in EXPORT_FORMATS if "include" in FORMATS[n].options]


@pytest.mark.parametrize("form", SELECTING)
def test_frame_with_an_unmeasured_box_is_written_or_left_out_as_a_whole(form):
    frames = [
        exporting.frame("whole", box(0)),
        exporting.frame("part", box(1), box(2, "unmeasured"), box(3, "rejected")),
        exporting.frame("answered", box(4, "unmeasured", **KEPT_BY_PERSON)),
        exporting.frame("gone", box(5, "unmeasured", **REJECTED_BY_PERSON)),
    ]

    usual = exporting.export(form, frames)
    without = exporting.export(form, frames, include_unmeasured=False)

    for files, count in ((usual, 4), (without, 3)):
        assert sum(name.endswith(".png") for name in files) == count
    assert not any("part" in name for name in without)
    counts, fewer = manifest_of(usual)["counts"], manifest_of(without)["counts"]
    assert (counts["boxes"]["out"], counts["unmeasured"]) == (4, {"written": 1})
    assert (fewer["frames"]["in"], fewer["boxes"]["out"]) == (4, 2)
    assert fewer["unmeasured"] == {"frames_left_out": 1, "left_out": 1}
    assert fewer["not_kept_by_reason"] == {
        "below_threshold": 1,
        "frame_left_out": 1,
        "no_segmentation": 1,
        "rejected_by_person": 1,
    }
    part = {
        row["box"]: row["reason"]
        for row in manifest_of(without)["boxes"]
        if row["frame"] == "part"
    }
    assert part == {
        "1": "frame_left_out",
        "2": "no_segmentation",
        "3": "below_threshold",
    }


def test_unmeasured_box_is_written_as_it_came_and_cut_to_the_image():
    boxes = [
        box(0, "unmeasured"),
        box(1, "unmeasured", (90, 20, 100, 60), given={"xyxy": [90, 20, 130, 60]}),
    ]

    files = export([frame("7", *boxes)], split=(1.0,), images="none")

    assert files["labels/train/7.txt"] == (
        b"0 0.200000000 0.500000000 0.200000000 0.500000000\n"
        b"0 0.950000000 0.500000000 0.100000000 0.500000000\n"
    )


def test_dropped_boxes_are_counted_by_reason():
    boxes = [
        box(0, "rejected"),
        box(1, **REJECTED_BY_PERSON),
        box(2, "rejected", None, **KEPT_BY_PERSON),
        box(3, xyxy=(120, 0, 140, 9)),
    ]

    counts = manifest_of(export([frame("7", *boxes)], images="none"))["counts"]

    assert counts["not_kept_by_reason"] == {
        "below_threshold": 2,
        "degenerate": 1,
        "rejected_by_person": 1,
    }
    car = counts["classes"]["car"]
    assert in_out_counts(car) == (4, 0, 4, 0)
    assert (car["kept"], car["rejected"]) == (2, 2)


def test_split_gives_each_map_its_share_and_is_stable():
    keys = [f"{number:06}" for number in range(4000)]

    for town in ("Town01", "Town02", None):
        train = sum(split_of(key, town, 0.8) == "train" for key in keys)
        assert 0.77 < train / len(keys) < 0.83
    wider = {key for key in keys if split_of(key, "Town01", 0.9) == "train"}
    assert {key for key in keys if split_of(key, "Town01", 0.8) == "train"} <= wider


def test_class_missing_in_the_class_list_fails_the_export():
    with pytest.raises(ExportError, match="class 'car' is not among"):
        export([frame("7", box(0))], ExportHead(("van",)))


LABELS = [
    name for name, form in FORMATS.items() if "allow_missing_images" in form.options
]


@pytest.mark.parametrize("form", LABELS)
def test_frame_without_image_is_left_out_of_labels_unless_it_is_asked_for(form):
    frames = [
        frame("7", box(0), read_image=lambda: b"PNG"),
        frame("8", box(0), box(1, verdict="rejected"), read_image=None),
    ]

    usual = exporting.export(form, frames)
    every = exporting.export(form, frames, allow_missing_images=True)
    alone = exporting.export(form, frames, images="none")

    assert manifest_of(usual)["counts"]["frames"]["left_out"] == 1
    assert manifest_of(usual)["counts"]["not_kept_by_reason"] == {"no_image": 2}
    assert [box["box"] for box in manifest_of(usual)["boxes"]] == ["0", "1"]
    for files in (every, alone):
        assert "left_out" not in manifest_of(files)["counts"]["frames"]
        assert manifest_of(files)["counts"]["boxes"]["out"] == 2
    assert manifest_of(every)["counts"]["frames"]["without_image"] == 1


def test_manifest_names_no_image_that_is_missing():
    files = exporting.export("manifest", [frame("8", box(0), read_image=None)])

    assert b'"image"' not in files["manifest.jsonl"]
    assert manifest_of(files)["counts"]["frames"]["without_image"] == 1
    assert "left_out" not in manifest_of(files)["counts"]["frames"]


OF_FOLDERS = ["../../etc/passwd", "..", ".", "/abs", "a//b", "a/./b", "C:\\x"]
RESERVED = ["con", "CON.txt", "images/1", "x/labels/1", "<>:|?*"]
ODD = ["a ", " a", "a.", ".a", "a\x00b", "a%2Fb", "é" * 200, "é" * 201]
HOSTILE = [*OF_FOLDERS, *RESERVED, *ODD]


def test_hostile_keys_give_safe_unique_file_names():
    stems = [file_stem(key) for key in HOSTILE]

    for stem in stems:
        parts = stem.split("/")
        assert not {"", ".", "..", "images", "labels", "con"} & set(parts)
        assert all(len(part.encode()) <= 255 for part in parts)
        assert "\\" not in stem
        assert "\x00" not in stem
    assert len(set(stems)) == len(HOSTILE)
    for key in ("Town05_1.5 km", "a/b/000007", "straße/é"):
        assert file_stem(key) == key


OF_FRAME = {"map": "Town01", "camera": {"width": 100, "height": 80}}


def test_decisions_jsonl_has_one_line_per_frame_in_order():
    files = {}
    frames = [frame("b", box(0), palette="carla-0.9.14"), frame("a")]

    def sink(name, pieces):
        files[name] = b"".join(pieces)

    write_export("decisions-jsonl", iter(frames), sink, HEAD, ExportOptions())

    first, second = map(json.loads, files["decisions.jsonl"].splitlines())
    of_first = {"palette": "carla-0.9.14", "decisions": [box(0).decision]}
    assert first == {"key": "b", **OF_FRAME, **of_first}
    assert second == {"key": "a", **OF_FRAME, "palette": None, "decisions": []}
    counts = json.loads(files["manifest.json"])["counts"]
    assert in_out_counts(counts["boxes"]) == (1, 1, 0, 0)


def test_long_list_of_dropped_boxes_in_the_manifest_is_complete():
    frames = [
        frame(f"{n:0200}", *[box(i, "rejected") for i in range(30)]) for n in range(600)
    ]

    document = manifest_of(export(frames, images="none"))

    assert len(document["boxes"]) == document["counts"]["boxes"]["dropped"] == 18_000
