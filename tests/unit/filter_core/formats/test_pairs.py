"""The layout `pairs`: segmentations are found by their folder or the name's end."""

import json

import numpy as np
import pytest

from filter_core.config.filter import FilterConfig
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.registry import read_source
from filter_core.local import filter_one
from tests.support.folders import LAYOUT_FILES, street_tags, write_files
from tests.support.pictures import painted, png
from tests.support.sensors import instance_png

BOXES = {"boxes": [{"class": "car", "xyxy": [1, 2, 3, 4]}], "map": "Town01"}


def key_and_paths(frame):
    return frame.key, frame.image, frame.segmentation


def test_segmentation_is_found_by_folder_or_name_suffix(tmp_path):
    files = {
        **dict.fromkeys(("1.png", "1_seg.png", "2.png", "seg/2.png", "9_seg.png")),
        "1.json": json.dumps(BOXES),
        "7.json": "{}",
        "notes.md": "",
    }
    write_files(tmp_path, files)

    frames = read_source(tmp_path)
    first, second = frames

    assert (frames.layout, frames.count, frames.classes) == ("pairs", 2, None)
    assert key_and_paths(first) == ("1", tmp_path / "1.png", tmp_path / "1_seg.png")
    assert key_and_paths(second) == ("2", tmp_path / "2.png", tmp_path / "seg/2.png")
    assert (first.annotation, second.annotation) == (BOXES, {"boxes": []})
    assert [(file.path, file.why) for file in frames.unmatched] == [
        ("9_seg.png", "no image for this segmentation"),
        ("7.json", "no image of this name"),
    ]


@pytest.mark.parametrize("ending", ["-seg", "_SEG", ".semantic", " segmentation"])
def test_common_segmentation_suffixes_are_recognised(tmp_path, ending):
    write_files(tmp_path, dict.fromkeys((f"rgb/1{ending}.png", "rgb/1.jpg")))

    (frame,) = read_source(tmp_path)

    assert frame.segmentation == tmp_path / f"rgb/1{ending}.png"


def test_ambiguous_segmentation_name_is_not_assigned(tmp_path):
    names = ("a/1.png", "b/1.png", "b/2.png", "seg/1.png", "seg/b/2.png")
    write_files(tmp_path, dict.fromkeys(names))

    frames = read_source(tmp_path)

    segmentations = {frame.key: frame.segmentation for frame in frames}
    assert segmentations == {"a/1": None, "b/1": None, "b/2": tmp_path / "seg/b/2.png"}
    assert [file.path for file in frames.unmatched] == ["seg/1.png"]


def test_segmentation_and_label_folders_can_be_given(tmp_path):
    files = {"rgb/1.png": None, "tags/1.png": None, "boxes/1.json": json.dumps(BOXES)}
    write_files(tmp_path, files)
    options = RecordingDescription(
        segmentation=tmp_path / "tags", labels=tmp_path / "boxes"
    )

    (frame,) = read_source(tmp_path, "pairs", options)

    assert frame.segmentation == tmp_path / "tags/1.png"
    assert frame.annotation == BOXES
    # Labels of other layouts are listed.
    files = {"1.png": None, "1.txt": "0 1 1 1 1", "a.xml": "<a/>"}
    other = write_files(tmp_path / "other", files)
    frames = read_source(other, "pairs")

    assert [file.path for file in frames.unmatched] == ["1.txt", "a.xml"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "1.json: expected JSON in UTF-8, found a fault at line 1"),
        ("[]", "1.json: expected one JSON object, found a list of 0"),
    ],
)
def test_invalid_annotation_is_a_problem_of_its_frame(tmp_path, text, words):
    write_files(tmp_path, {"1.png": None, "1.json": text, "2.png": None})

    bad, good = read_source(tmp_path)

    assert words in str(bad.problem)
    assert (bad.annotation, good.annotation) == (None, {"boxes": []})


IDS = np.full((60, 80), 7)
INSTANCES = instance_png(street_tags(), IDS)
SEGMENTATION = png(painted(street_tags()))
CAR = {"boxes": [{"class": "car", "xyxy": [10, 10, 50, 40]}], "carla_version": "0.9.15"}


@pytest.mark.parametrize(
    ("names", "key", "label"),
    [
        (("inst/7.png",), "7", "7"),
        (("7_instance.png",), "7", "7"),
        (("7_instance.png",), "7", "7_instance"),
        (("instance_segmentation.png",), "instance_segmentation", None),
        (("seg/7.png",), "7", "7"),
        (("7_semseg.png",), "7", "7_semseg"),
        (("inst/front/7.png", "seg/front/7.png"), "front/7", "front/7"),
    ],
)
def test_image_of_tags_is_a_frame_of_its_size_where_there_is_no_picture(
    tmp_path, names, key, label
):
    write_files(tmp_path, {f"{label or key}.json": json.dumps(CAR)})
    for name in names:
        is_semantic = "sem" in name or "seg/" in name
        write_files(tmp_path, {name: SEGMENTATION if is_semantic else INSTANCES})

    frames = read_source(tmp_path)
    (frame,) = frames
    outcome = filter_one(frame, FilterConfig(evidence="auto"))

    assert (frames.count, frames.unmatched, frame.key) == (1, (), key)
    assert frame.image is None
    assert outcome.decisions is not None, outcome.error
    (decision,) = outcome.decisions
    assert (decision["verdict"], decision["box_pixels"]) == ("kept", 1200)
    channel = "instance" if "instances" in frame.others else "semantic"
    assert decision["evidence"] == channel


def test_images_of_tags_beside_pictures_are_no_frames(tmp_path):
    tags = dict.fromkeys(("inst/1.png", "inst/2.png"), INSTANCES)
    write_files(tmp_path, {"rgb/1.png": None, **tags})

    frames = read_source(tmp_path)

    assert [frame.key for frame in frames] == ["rgb/1"]
    assert [file.path for file in frames.unmatched] == ["inst/2.png"]


@pytest.mark.parametrize("kind", ["inst", "seg"])
@pytest.mark.parametrize("layout", ["yolo", "voc", "kitti", "coco"])
def test_labels_without_pictures_have_the_size_of_their_image_of_tags(
    tmp_path, layout, kind
):
    number = {"kitti": "000000", "coco": "7"}.get(layout, "1")
    labels = {
        name: content
        for name, content in LAYOUT_FILES[layout].items()
        if not name.endswith((".png", ".jpg"))
    }
    content = INSTANCES if kind == "inst" else SEGMENTATION
    write_files(tmp_path, {**labels, f"{kind}/{number}.png": content})

    frames = read_source(tmp_path, layout)
    (frame,) = frames
    outcome = filter_one(frame, FilterConfig(evidence="auto", palette="carla-0.9.14"))

    assert frames.unmatched == ()
    assert outcome.decisions is not None, outcome.error
    (decision,) = outcome.decisions
    by = ("instance",) if kind == "inst" else ("semantic", "ordered")
    assert decision["evidence"] in by
    assert decision["verdict"] != "unmeasured"
