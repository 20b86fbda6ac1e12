"""Reading and writing KITTI: rectangles, 3D boxes, DontCare regions, calibrations."""

import numpy as np
import pytest

from filter_core.annotation.frame import frame_boxes_2d
from filter_core.annotation.parsing import parse_annotation
from filter_core.formats.kitti import kitti_vertices, to_kitti_box
from filter_core.formats.registry import read_source
from filter_core.geometry.camera import Camera
from filter_core.geometry.pose import Transform
from tests.support.exporting import box, convert, export, frame
from tests.support.folders import annotation_of, write_files
from tests.support.pictures import png

# KITTI's own first training label and calibration (object 000000), rounded.
PEDESTRIAN = (
    "Pedestrian 0.00 0 -0.20 712.40 143.00 810.73 307.92 "
    "1.89 0.48 1.20 1.84 1.47 8.41 0.01"
)
REGION = "DontCare -1 -1 -10 5.00 6.00 7.00 9.00 -1 -1 -1 -1000 -1000 -1000 -10"
P2 = "P2: 707.0493 0 604.0814 45.75831 0 707.0493 180.5066 -0.3454157 0 0 1 0.004981016"

HIGH = {"x": 0, "y": 0, "z": 1.6, "pitch": 0, "yaw": 0, "roll": 0}
SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
AHEAD = SIGNS * [2.0, 1.0, 0.8] + [10.0, 0.0, 0.8]


def folder(tmp_path, label, calibration=f"P0: 1\n{P2}\n"):
    files = {
        "label_2/000000.txt": label,
        "image_2/000000.png": png(np.zeros((370, 1224, 3), np.uint8)),
        "calib/000000.txt": calibration,
    }
    write_files(tmp_path / "training", files)
    return tmp_path


def test_kitti_line_is_read_as_rectangle_with_kitti_fields(tmp_path):
    source = folder(tmp_path, f"{PEDESTRIAN}\n{REGION}\n")

    frames = read_source(source)
    (frame,) = frames
    parsed = parse_annotation(annotation_of(frame))

    assert (frames.layout, frames.unmatched, frame.key) == ("kitti", (), "000000")
    (read,) = parsed.boxes
    assert (read.class_name, read.form) == ("Pedestrian", "xyxy")
    assert read.values == (712.4, 143.0, 810.73, 307.92)
    solid = {"dimensions": [1.89, 0.48, 1.2], "location": [1.84, 1.47, 8.41]}
    turned = {"alpha": -0.2, "rotation_y": 0.01}
    assert read.raw["kitti"] == {"truncated": 0.0, "occluded": 0, **solid, **turned}
    # The centre is half a height above the bottom; P2's camera is 6 cm to the left.
    centre = [1.84 + 0.0604, 1.47 - 0.945, 8.41 + 0.005]
    assert read.distance == pytest.approx(np.linalg.norm(centre), abs=2e-3)
    assert annotation_of(frame)["dontcare"] == [[5.0, 6.0, 7.0, 9.0]]


def test_kitti_label_file_round_trips(tmp_path):
    source = folder(tmp_path, f"{PEDESTRIAN}\n{REGION}\n")

    files = convert("kitti", source)

    lines = files["training/label_2/000000.txt"].decode().splitlines()
    same = [[float(word) for word in line.split()[1:]] for line in lines]
    numbers = [[float(w) for w in line.split()[1:]] for line in (PEDESTRIAN, REGION)]
    assert same == numbers
    assert lines[0] == PEDESTRIAN


@pytest.mark.parametrize("absent", ["0 0 0 0", "-1 -1 -1 -1", "-1.00 -1 -1.0 -1"])
def test_a_line_with_only_a_3d_box_is_projected(tmp_path, absent):
    bare = PEDESTRIAN.replace("712.40 143.00 810.73 307.92", absent)
    (frame,) = read_source(folder(tmp_path, bare))

    parsed = parse_annotation(annotation_of(frame))
    made = frame_boxes_2d(parsed, (1224, 370))

    assert parsed.boxes[0].form == "vertices"
    # KITTI's authors drew the rectangle around this pedestrian by hand.
    np.testing.assert_allclose(made.xyxy[0], [712, 143, 811, 308], atol=10)


@pytest.mark.parametrize(
    "corners",
    ["810.73 143 712.4 307.92", "712.4 307.92 810.73 143", "5 5 5 5", "810.73 9 3 2"],
)
def test_a_rectangle_without_extent_is_not_replaced_by_the_3d_box(tmp_path, corners):
    line = PEDESTRIAN.replace("712.40 143.00 810.73 307.92", corners)
    (frame,) = read_source(folder(tmp_path, line))

    (box_read,) = annotation_of(frame)["boxes"]

    assert box_read["xyxy"] == [float(word) for word in corners.split()]
    assert "vertices" not in box_read


def test_a_line_without_rectangle_is_an_error_where_it_cannot_be_computed(tmp_path):
    bare = PEDESTRIAN.replace("712.40 143.00 810.73 307.92", "-1 -1 -1 -1")
    source = folder(tmp_path, f"{PEDESTRIAN}\n{bare}")
    (source / "training/calib/000000.txt").unlink()
    (frame,) = read_source(source)

    assert "000000.txt, line 2: expected a rectangle" in str(frame.problem)


@pytest.mark.parametrize("yaw", [0.0, 30.0, 90.0, 179.0, -120.0])
def test_3d_box_round_trips_through_kitti_parameters(yaw):
    camera = Camera.from_fov(800, 600, 90.0, {"x": 3, "y": -2, "z": 1.5, "yaw": 20})
    turned = Transform(location=(20.0, 4.0, 0.8), rotation=(0.0, yaw, 0.0))
    corners = SIGNS * [2.2, 0.9, 0.8] @ turned.matrix[:3, :3].T + turned.matrix[:3, 3]

    dimensions, location, rotation_y, _ = to_kitti_box(corners, camera)
    back = kitti_vertices(dimensions, location, rotation_y)

    assert dimensions == pytest.approx((1.6, 1.8, 4.4))
    motion = camera.world_to_camera
    seen = corners @ motion[:3, :3].T + motion[:3, 3]
    np.testing.assert_allclose(back, seen, atol=1e-9)


def test_kitti_3d_columns_and_calibration_are_those_of_the_camera():
    """KITTI's rotation_y is 0 to the right and -pi/2 straight ahead."""
    seen = to_kitti_box(AHEAD, Camera.from_fov(800, 600, 90.0, HIGH))
    assert seen[1] == pytest.approx((0.0, 1.6, 10.0))
    assert seen[2:] == pytest.approx((-np.pi / 2, -np.pi / 2))
    camera = {"width": 100, "height": 80, "fov": 90.0, "transform": HIGH}
    solid = box(0, given={"vertices": AHEAD.tolist()})
    made = frame("a", solid, annotation={"camera": camera})
    files = export("kitti", [made], split=1.0)

    columns = files["training/label_2/000000.txt"].decode().split()
    assert columns[8:11] == ["1.60", "2.00", "4.00"]
    assert columns[11:] == ["0.00", "1.60", "10.00", "-1.5708"]
    text = files["training/calib/000000.txt"].decode()
    rows = dict(line.split(": ") for line in text.splitlines())
    p2 = [float(number) for number in rows["P2"].split()]
    assert p2 == [50, 0, 50, 0, 0, 50, 40, 0, 0, 0, 1, 0]
    assert " ".join(rows) == "P0 P1 P2 P3 R0_rect Tr_velo_to_cam Tr_imu_to_velo"


NOT_FINITE = PEDESTRIAN.replace("8.41", "nan")


@pytest.mark.parametrize(
    ("label", "calibration", "words"),
    [
        ("car 0 0", P2, "000000.txt, line 1: expected 15 columns"),
        (NOT_FINITE, P2, "expected a finite number, found 'nan'"),
        (PEDESTRIAN, "P3: 1", "expected a line 'P2:', found none"),
        (PEDESTRIAN, "P2: 1 2", "P2: expected 12 numbers, found 2"),
        (PEDESTRIAN, f"P2: {'0 ' * 12}", "P2: not a valid camera"),
    ],
)
def test_invalid_label_or_calibration_is_a_problem_of_its_frame(
    tmp_path, label, calibration, words
):
    (frame,) = read_source(folder(tmp_path, f"{label}\n", calibration))

    assert frame.annotation is None
    assert words in str(frame.problem)


def test_calibration_without_label_file_is_listed_as_unmatched(tmp_path):
    source = folder(tmp_path, "")
    write_files(tmp_path, {"training/calib/000009.txt": P2})

    frames = read_source(source)

    assert [(file.path, file.why) for file in frames.unmatched] == [
        ("000009.txt", "no label file for this calibration")
    ]
    assert [annotation_of(frame)["boxes"] for frame in frames] == [[]]


def test_label_folders_of_parts_are_one_recording(tmp_path):
    picture = png(np.zeros((9, 9, 3), np.uint8))
    for part in ("val", "train"):
        files = {"label_2/a.txt": PEDESTRIAN, "image_2/a.png": picture}
        write_files(tmp_path / part, files)

    source = read_source(tmp_path)

    frames = {frame.key: annotation_of(frame) for frame in source}
    assert (source.layout, source.count, source.unmatched) == ("kitti", 2, ())
    parts = {key: frame["split"] for key, frame in frames.items()}
    assert parts == {"train/a": "train", "val/a": "val"}
    assert all(len(frame["boxes"]) == 1 for frame in frames.values())
