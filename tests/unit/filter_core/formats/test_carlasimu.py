"""Folders as carlasimu writes them, on Windows and on Linux."""

import json
from dataclasses import replace

import numpy as np
import pytest

from filter_core.config.filter import FilterConfig
from filter_core.errors import AnnotationErrors
from filter_core.formats.registry import read_source
from filter_core.images.drawing import decoded
from filter_core.local import filter_source
from filter_core.pipeline import filter_frame
from tests.support.exporting import HEAD, box, convert, export, frame
from tests.support.folders import (
    annotation_of,
    street_tags,
    write_carlasimu,
    write_files,
)
from tests.support.pictures import painted, png

NEAR, MIDDLE, FAR = (f"0 0.{n} 0.5 0.1 0.2" for n in (2, 4, 6))
BOXES = [(FAR, 180.0), (NEAR, 50.0), (MIDDLE, 50.1), (NEAR, 120.0)]


@pytest.mark.parametrize(
    ("folder", "separator"),
    [("", "/"), ("out", "/"), ("out/cam", "/"), ("", "\\"), (r"out\cam", "\\")],
)
def test_tree_is_read_from_any_of_its_folders(tmp_path, folder, separator):
    write_carlasimu(tmp_path, BOXES, separator=separator)

    frames = read_source(tmp_path / folder)
    (frame,) = frames

    assert frames.layout == "carlasimu"
    above, name = f"{tmp_path}/out{separator}", "00000993"
    assert str(frame.segmentation) == f"{above}seg/{name}.png"
    others = {role: str(path) for role, path in frame.others.items()}
    radar = f"{above}radar/{name}.ply"
    assert others == {"depth": f"{above}depth/{name}.png", "radar": radar}
    annotation = annotation_of(frame)
    assert annotation["map"] == "Town10HD_Opt"
    assert annotation["weather"] == {"cloudiness": 20, "fog_distance": 0.75}
    # Of two boxes with the same line, the nearer one comes first.
    ranges = [box["distance_range"] for box in annotation["boxes"]]
    assert ranges == [[150, 200], [0, 50], [50, 100], [100, 150]]
    assert any("LiDAR files are not measured" in note for note in frames.notes())


def test_distance_range_is_in_decisions_and_counts_for_limits(tmp_path):
    frames = read_source(write_carlasimu(tmp_path, BOXES))

    config = FilterConfig(min_distance=51, max_distance=150)
    (outcome,) = filter_source(frames, config)

    decisions = outcome.decisions or []
    ranges = [(box["distance"], box["distance_range"]) for box in decisions]
    assert ranges == [(None, [n, n + 50]) for n in (150, 0, 50, 100)]
    # The third may be nearer or farther than 51 m.
    refused = [box["reason"] == "out_of_range" for box in decisions]
    assert refused == [True, True, False, False]
    assert decisions[0]["explanation"] == (
        "rejected: it is 150 to 200 m away, at most 150 m are allowed"
    )
    # A single band bounds the distance from above.
    single = write_carlasimu(tmp_path / "single", [(NEAR, 20)], bands=(70,))
    (frame,) = read_source(single)
    (box,) = annotation_of(frame)["boxes"]
    assert box["distance_range"] == [0, 70]


@pytest.mark.parametrize("wrong", [[100, 50], [-1, 50], [50], "50-100", [None, 1]])
def test_invalid_distance_range_is_refused(wrong):
    box = {"class": "car", "xyxy": [0, 0, 1, 1], "distance_range": wrong}

    with pytest.raises(AnnotationErrors, match="distance_range"):
        filter_frame({"boxes": [box]}, None, FilterConfig())


THEIR_CLASSES = ("car", "bus", "truck", "van", "walker", "street_light")
THEIR_NUMBERS = dict(zip(THEIR_CLASSES, range(6), strict=True))


def test_their_own_tree_comes_back_with_its_files_and_numbers(tmp_path):
    source = write_carlasimu(tmp_path, BOXES)

    files = convert("carlasimu", source, "carlasimu", drawn=True, pictures=1)

    (theirs,) = read_source(write_files(tmp_path / "again", files))
    (ours,) = read_source(source)
    assert annotation_of(theirs) == {**annotation_of(ours), "split": "val"}
    pictures = [f"out/{kind}/00000993.png" for kind in ("cam/images", "seg", "depth")]
    for name in (*pictures, "out/radar/00000993.ply", "out/lidar/00000993.ply"):
        assert files[name] == (source / name).read_bytes(), name
    readme = json.loads((source / "out/cam/Readme.txt").read_text())
    readme["distance"].pop("min_distance")
    written = json.loads(files["out/cam/Readme.txt"])
    assert written == readme | {"classes": THEIR_NUMBERS}
    before, after = (
        decoded(files[f"out/cam/{folder}/00000993.png"])
        for folder in ("images_bbox", "images_bbox_filter")
    )
    assert before.shape == (60, 80, 3)
    assert before.any()
    np.testing.assert_array_equal(before, after)  # every box is included
    drawn = {f"pictures/{part}/00000993.png" for part in ("after", "before")}
    drawn |= {"pictures/index.html", "pictures/sheet.png"}
    assert {name for name in files if name.startswith("pictures/")} == drawn
    page = files["pictures/index.html"].decode()
    assert "4 of 4 boxes are written" in page
    assert decoded(files["pictures/sheet.png"]).shape[1] == 480


def test_a_capture_becomes_their_tree_with_colours_and_points_and_is_read_again(
    tmp_path,
):
    car = {"class": "car", "xyxy": [10, 20, 30, 40], "distance": 60}
    images = {"image": "rgb.png", "segmentation": "tags.png"}
    extra = {"files": {"lidar_intensity": "points.ply"}}
    line = {"key": "a", "carla_version": "0.9.15", "boxes": [car], "extra": extra}
    captured = {
        "manifest.jsonl": json.dumps({**line, **images}),
        "tags.png": png(street_tags()),
        "rgb.png": png(np.zeros((60, 80, 3), np.uint8)),
        "points.ply": "ply",
    }

    files = convert("carlasimu", write_files(tmp_path / "capture", captured))

    assert files["out/lidar/a.ply"] == b"ply"
    colours = decoded(png(painted(street_tags())))
    np.testing.assert_array_equal(decoded(files["out/seg/a.png"]), colours)
    frames = read_source(write_files(tmp_path / "again", files))
    (again,) = filter_source(frames, FilterConfig())
    assert (again.decisions or [])[0]["distance_range"] == [50, 100]


def test_boxes_lie_in_the_bands_of_their_true_distance_under_their_numbers():
    metres = {"car": 50.0, "pedestrian": 50.01, "Traffic Light": 150.0}
    metres |= {"motorcycle": 200.0, "truck": 200.5}
    boxes = [
        box(number, class_name=name, distance=distance)
        for number, (name, distance) in enumerate(metres.items())
    ]
    head = replace(HEAD, classes=tuple(metres))

    files = export("carlasimu", [frame("a", *boxes, map="Town01")], head)

    bands = {50: "0", 100: "04", 150: "045", 200: "0456"}
    for band, numbers in bands.items():
        lines = files[f"out/cam/labels/label{band}/a.txt"].decode().splitlines()
        assert [line.split()[0] for line in lines] == [*numbers]
    assert json.loads(files["manifest.json"])["beyond_all_bands"] == 1
    readme = json.loads(files["out/cam/Readme.txt"])
    assert readme["classes"] == THEIR_NUMBERS | {"motorcycle": 6}
    assert readme["map"] == "Town01"
    assert readme["distance"] == {"max_distance": [*bands]}
