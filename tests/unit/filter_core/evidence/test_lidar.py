"""Point files: reading LiDAR, checking LiDAR and radar, counting points in boxes."""

import tracemalloc

import numpy as np
import pytest

from filter_core.evidence.lidar import (
    PointsError,
    check_points,
    points_inside,
    read_points,
)
from filter_core.geometry.pose import Transform
from tests.support.lidar import POINTS, TABLE, ascii_ply, header, npy, npy_of_columns
from tests.support.sensors import CAR, box_ahead


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
def test_ply_and_npy_forms_give_the_same_points(content):
    xyz, tags = read_points(content)

    assert xyz.tolist() == [[1.5, -2.0, 0.25], [8.0, 9.0, 1.0]]
    assert tags.tolist() == [CAR, 1]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "PLY or NPY"),
        (b"ply\nformat ascii 1.0\n", "header with end_header"),
        (header("ascii") + b"1 2 3", "truncated"),
        (header("ascii") + b"a b c d e f " * 2, "text among the points"),
        (header("binary_little_endian") + TABLE.tobytes()[:-1], "truncated"),
        (header("ascii", 10**12), "at most 20,000,000 points"),
        (
            header("ascii", 1) + b"1" * (3 << 20) + b" 1 2",
            "word of more than|truncated",
        ),
        (header("latin", 0), "format ascii or binary"),
        (header("ascii", 0).replace(b"ObjTag", b"Label2"), "column objtag"),
        (npy(TABLE)[:-3], "complete NumPy array"),
        (npy(TABLE)[: -TABLE.nbytes - 12], "found a truncated header"),
        (npy(np.array([{"a": 1}], object)), "complete NumPy array"),
        (npy(np.zeros((4, 3))), "6 columns"),
        (npy(np.full((1, 6), np.nan)), "finite"),
    ],
)
def test_read_points_refuses_an_invalid_file(content, words):
    with pytest.raises(PointsError, match=words):
        read_points(content)


def test_points_are_placed_by_the_sensors_own_transform():
    xyz = np.array([[10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [10.0, 0.0, 0.0]])
    turned = Transform((100.0, 50.0, 0.0), (0.0, 90.0, 0.0))
    ahead_of_it = box_ahead(0.0, half=1.0) + np.array([100.0, 60.0, 0.0])
    flat = np.full((8, 3), np.nan)

    counts = points_inside(
        xyz,
        np.array([CAR, CAR, 1]),
        turned,
        np.stack([ahead_of_it, box_ahead(10.0, half=1.0), flat]),
        np.full(3, 1 << CAR, np.int64),
    )

    assert counts.tolist() == [1, 0, -1]


RADAR = np.zeros(3, [("x", "<f4"), ("velocity", "<f4")])
RADAR_PLY = (
    b"ply\nformat binary_little_endian 1.0\nelement vertex 3\n"
    b"property float x\nproperty float velocity\nend_header\n"
)
LONG_NAMES = "a column whose name is not 1 to 64 characters of text"
VALID_FILES = [
    pytest.param(ascii_ply(), "lidar", "ply", id="ascii"),
    pytest.param(header("ascii", 0), "lidar", "ply", id="no points"),
    pytest.param(
        header("binary_little_endian") + TABLE.tobytes(), "lidar", "ply", id="binary"
    ),
    pytest.param(npy(TABLE), "lidar", "npy", id="named npy"),
    pytest.param(npy(np.array(POINTS)), "lidar", "npy", id="plain npy"),
    pytest.param(RADAR_PLY + RADAR.tobytes(), "radar", "ply", id="radar"),
    pytest.param(npy(RADAR), "radar", "npy", id="radar npy"),
    pytest.param(npy(np.zeros((5, 4))), "radar", "npy", id="plain radar npy"),
    pytest.param(npy_of_columns("ü" * 31), "radar", "npy", id="names of their own"),
]


@pytest.mark.parametrize(("content", "sensor", "kind"), VALID_FILES)
def test_check_points_detects_the_media_type_from_content(content, sensor, kind):
    assert check_points(content, sensor=sensor) == f"application/x-{kind}"


INVALID = {
    "four bytes": (b"ply\n", "lidar", "header with end_header"),
    "a beginning": (b"\x93NUMPY", "lidar", "complete NumPy array"),
    "neither": (b"v1 2 3", "radar", "PLY or NPY"),
    "npy, cut": (npy(TABLE)[:-1], "lidar", "complete NumPy"),
    "npy and more": (npy(TABLE) + b"x", "lidar", "complete NumPy"),
    "npy, narrow": (npy(np.zeros((4, 3))), "lidar", "6 columns"),
    "npy of one number": (npy(np.zeros(())), "radar", "rows"),
    "a radar's as LiDAR": (npy(RADAR), "lidar", "column"),
    "a radar's PLY as LiDAR": (RADAR_PLY, "lidar", "column"),
    "half a name": (npy_of_columns("\ud800"), "lidar", LONG_NAMES),
    "radar's half": (npy_of_columns("\ud800"), "radar", LONG_NAMES),
    "a long name": (npy_of_columns("x" * 65), "radar", LONG_NAMES),
    "no name": (npy_of_columns(""), "radar", LONG_NAMES),
    "PLY, cut": (RADAR_PLY + bytes(23), "radar", "24 bytes"),
    "text, cut": (ascii_ply()[:-8], "lidar", "2 points of 6"),
    "too many points": (header("ascii", 20_000_001), "lidar", "20,000,000"),
    "as many as allowed": (header("ascii", 20_000_000), "lidar", "found 0"),
}


@pytest.mark.parametrize(("content", "sensor", "words"), INVALID.values(), ids=INVALID)
def test_check_points_refuses_an_invalid_or_truncated_file(content, sensor, words):
    with pytest.raises(PointsError, match=words) as refused:
        check_points(content, sensor=sensor)

    assert refused.value.pointer == f"/{sensor}"
    assert f"the {sensor} file" in str(refused.value)


@pytest.mark.parametrize("blank", [" ", "\n", "\r\n", "\t\t"])
@pytest.mark.parametrize("size", [1, 2, 5])
def test_ascii_numbers_across_read_boundaries_are_counted_correctly(blank, size):
    """Words of several lengths, so that parts of the file end inside all of them.

    A part is a MiB, and each file is longer.
    """
    points = 90_000
    different = [str(number) for number in range(10**size)]
    words = (different * (points * 6 // len(different) + 1))[: points * 6]
    text = header("ascii", points) + blank.join(words).encode()

    assert check_points(text, sensor="lidar") == "application/x-ply"
    xyz, tags = read_points(text)
    assert len(xyz) == len(tags) == points
    assert [*xyz[-1], tags[-1]] == [*map(float, words[-6:-3]), int(words[-1])]
    with pytest.raises(PointsError, match="truncated"):
        check_points(text[: text.rindex(blank.encode())], sensor="lidar")


def test_reading_ascii_points_has_bounded_memory():
    points = 150_000
    text = header("ascii", points) + b"1 2 3 0 5 14\n" * points
    tracemalloc.start()
    try:
        check_points(text, sensor="lidar")
        _, checked = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        read_points(text)
        _, read = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()

    assert checked < 8 * 2**20
    assert read < 60 * 2**20 + 3 * 8 * 6 * points
