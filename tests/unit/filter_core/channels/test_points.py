"""Semantic LiDAR files, and which of their points are in a box."""

from __future__ import annotations

import io

import numpy as np
import pytest

from filter_core.channels.lidar import points_inside
from filter_core.channels.points import LidarPoints, PointsError, read_points
from filter_core.pose import Transform
from tests.unit.filter_core.channels.scene import box_ahead

CAR = 14
POINTS = [(1.5, -2.0, 0.25, 0.5, 217, CAR), (8.0, 9.0, 1.0, 1.0, 0, 1)]
DTYPE = [
    ("x", "<f4"),
    ("y", "<f4"),
    ("z", "<f4"),
    ("CosAngle", "<f4"),
    ("ObjIdx", "<u4"),
    ("ObjTag", "<u4"),
]
TABLE = np.array(POINTS, DTYPE)


def header(form: str, count: int = len(POINTS)) -> bytes:
    names = [name for name, _ in DTYPE]
    types = ["float32"] * 4 + ["uint32"] * 2
    lines = [f"property {kind} {name}" for kind, name in zip(types, names, strict=True)]
    top = ["ply", f"format {form} 1.0", f"element vertex {count}"]
    return "\n".join([*top, *lines, "end_header\n"]).encode()


def ascii_ply() -> bytes:
    rows = (" ".join(map(str, point)) for point in POINTS)
    return header("ascii") + "\n".join(rows).encode() + b"\n"


def npy(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        ascii_ply(),
        header("binary_little_endian") + TABLE.tobytes(),
        header("binary_big_endian")
        + TABLE.astype(TABLE.dtype.newbyteorder()).tobytes(),
        npy(TABLE),
        npy(np.array(POINTS, np.float64)),
    ],
    ids=["ascii", "little endian", "big endian", "structured npy", "plain npy"],
)
def test_every_form_gives_the_same_points(content):
    points = read_points(content)

    assert points.xyz.tolist() == [[1.5, -2.0, 0.25], [8.0, 9.0, 1.0]]
    assert points.object_id.tolist() == [217, 0]
    assert points.tag.tolist() == [CAR, 1]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "PLY or NPY"),
        (b"ply\nformat ascii 1.0\n", "header that ends"),
        (header("ascii") + b"1 2 3", "truncated"),
        (header("ascii") + b"a b c d e f " * 2, "words among the points"),
        (header("binary_little_endian") + TABLE.tobytes()[:-1], "truncated"),
        (header("ascii", 10**12), "at most 20,000,000 points"),
        (header("latin", 0), "format ascii or binary"),
        (header("ascii", 0).replace(b"ObjTag", b"Label2"), "column objtag"),
        (npy(TABLE)[:-3], "whole NumPy array"),
        (npy(np.array([{"a": 1}], object)), "whole NumPy array"),
        (npy(np.zeros((4, 3))), "6 columns"),
        (npy(np.full((1, 6), np.nan)), "finite"),
    ],
)
def test_what_is_no_measurement_is_refused_in_words(content, words):
    with pytest.raises(PointsError, match=words):
        read_points(content)


def test_the_sensors_own_place_counts_not_the_cameras():
    points = LidarPoints(
        np.array([[10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [10.0, 0.0, 0.0]]),
        np.zeros(3, np.int64),
        np.array([CAR, CAR, 1]),
    )
    turned = Transform((100.0, 50.0, 0.0), (0.0, 90.0, 0.0))
    ahead_of_it = box_ahead(0.0, half=1.0) + np.array([100.0, 60.0, 0.0])
    flat = np.full((8, 3), np.nan)

    counts = points_inside(
        points,
        turned,
        np.stack([ahead_of_it, box_ahead(10.0, half=1.0), flat]),
        np.full(3, 1 << CAR, np.int64),
    )

    assert counts.tolist() == [1, 0, -1]
