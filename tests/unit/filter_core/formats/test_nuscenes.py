"""Data sets in the tables of nuScenes."""

import json

import numpy as np
import pytest

from filter_core.annotation.frame import frame_boxes_2d
from filter_core.annotation.parsing import parse_annotation
from filter_core.errors import LayoutError
from filter_core.formats.registry import read_source
from tests.support.folders import annotation_of, write_files
from tests.support.nuscenes import BACK, FRONT, nuscenes_files
from tests.support.pictures import jpeg

WALKER = "human.pedestrian.adult"
BY_DEVKIT = {
    "CAM_FRONT": ("car 1", "vehicle.car", [781.8896, 456.7122, 1397.1888, 735.0147]),
    "CAM_BACK": ("walker 1", WALKER, [791.2077, 445.9198, 903.1245, 680.3321]),
}
"""By camera: the instance and the class of the box in front of it, and the rectangle
around its eight corners, as nuscenes-devkit 1.2.0 computes them of the same tables:
`NuScenes.get_sample_data`, `Box.corners`, `view_points`."""


def test_boxes_lie_where_the_devkit_of_nuscenes_projects_them(tmp_path):
    picture = jpeg(np.zeros((900, 1600, 3), np.uint8))
    files = nuscenes_files("front", "back") | {FRONT: picture, BACK: picture}
    write_files(
        tmp_path, {**files, "sweeps/CAM_FRONT/1.jpg": b"", "samples/1.jpg": b""}
    )

    recording = read_source(tmp_path)
    frames = {frame.key.split("/")[0]: frame for frame in recording}

    assert (recording.layout, {*frames}) == ("nuscenes", {*BY_DEVKIT})
    assert [file.path for file in recording.unmatched] == ["samples/1.jpg"]
    for name, frame in frames.items():
        annotation = parse_annotation(annotation_of(frame))
        instance, category, rectangle = BY_DEVKIT[name]
        names = [(box.id, box.class_name) for box in annotation.boxes]
        xyxy = frame_boxes_2d(annotation, (1600, 900)).xyxy.tolist()
        seen = dict(zip(names, xyxy, strict=True))
        assert seen.pop((instance, category)) == pytest.approx(rectangle, abs=1e-3)
        (behind,) = seen.values()
        assert max(behind) < 0


def test_boxes_in_a_world_without_turns_are_computed_by_hand(tmp_path):
    """The camera looks along the world's x, 2 m above the origin; a box of 4 m length,
    2 m width and 1 m height lies 10 m before it, 1 m to the left."""
    along_x, straight = [0.5, -0.5, 0.5, -0.5], [1, 0, 0, 0]
    box = {"translation": [10, 1, 1], "size": [2, 4, 1], "rotation": straight}
    changes: dict[str, dict[str, object]] = {
        "ego_pose": {"translation": [0, 0, 0], "rotation": straight},
        "calibrated_sensor": {"translation": [0, 0, 2], "rotation": along_x},
        "sample_annotation": {**box},
    }
    files = nuscenes_files("front")
    for table, change in changes.items():
        name = f"v1.0-mini/{table}.json"
        rows = [{**row, **change} for row in json.loads(files[name])]
        files[name] = json.dumps(rows).encode()
    write_files(tmp_path, {**files, FRONT: jpeg(np.zeros((900, 1600, 3), np.uint8))})

    (frame,) = read_source(tmp_path)

    annotation = parse_annotation(annotation_of(frame))
    focal, u, v = 1266.4, 816.3, 491.5
    assert frame_boxes_2d(annotation, (1600, 900)).xyxy[0] == pytest.approx(
        [u - focal * 2 / 8, v + focal * 0.5 / 12, u, v + focal * 1.5 / 8]
    )


@pytest.mark.parametrize(
    ("table", "change", "words"),
    [
        ("ego_pose", {"token": "b"}, "ego_pose.json: expected a row with the token"),
        ("sample_annotation", {"size": [1, 2]}, "size: expected 3 numbers, found"),
        ("sample_annotation", {"rotation": [0, 0, 0, 0]}, "expected a quaternion"),
        ("sample_data", {"ego_pose_token": [1]}, "ego_pose.json: expected a row with"),
        ("instance", {"category_token": None}, "category.json: expected a row"),
    ],
)
def test_bad_row_is_the_problem_of_its_frames(tmp_path, table, change, words):
    files = nuscenes_files("front")
    name = f"v1.0-mini/{table}.json"
    files[name] = json.dumps([row | change for row in json.loads(files[name])]).encode()

    (frame,) = read_source(write_files(tmp_path, files))

    assert words in str(frame.problem)


def test_tables_of_several_versions_or_none_are_refused(tmp_path):
    files = nuscenes_files("front")
    others = {name.replace("mini", "trainval"): text for name, text in files.items()}

    with pytest.raises(LayoutError, match=r"found v1\.0-mini and v1\.0-tr"):
        read_source(write_files(tmp_path, {**files, **others}))
    with pytest.raises(LayoutError, match="expected one folder of tables"):
        read_source(write_files(tmp_path / "empty", {"1.png": None}), "nuscenes")
