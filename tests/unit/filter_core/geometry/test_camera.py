"""Cameras and transforms: CARLA's matrices, all ways to write them, and faults."""

import json

import numpy as np
import pytest

from filter_core.errors import AnnotationErrors, FilterError
from filter_core.geometry.camera import Camera
from filter_core.geometry.pose import Transform, as_transform
from tests.support.sources import CHECKOUT

CASES = json.loads((CHECKOUT / "tests" / "data" / "geometry_cases.json").read_text())
POSE = {"x": 1, "y": 2, "z": 3, "pitch": 4, "yaw": 5, "roll": 6}
K = [[640, 0, 640], [0, 640, 360], [0, 0, 1]]


@pytest.mark.parametrize("case", CASES, ids=lambda case: str(case["id"]))
def test_inverse_matrix_equals_carlas_matrix(case):
    inverse = as_transform(case["camera"]).inverse_matrix

    carla = np.array(case["carla"]["camera_inverse_matrix"])
    np.testing.assert_allclose(inverse, carla, atol=1e-4)


def test_camera_from_matrices_equals_camera_from_fov():
    pose = Transform((1, 2, 3), (4, 5, 6))
    by_fov = Camera.from_fov(1280, 720, 90, pose)

    by_matrices = Camera.from_matrices(1280, 720, K, pose.inverse_matrix)

    np.testing.assert_allclose(by_matrices.world_to_image, by_fov.world_to_image)
    np.testing.assert_allclose(by_matrices.position, [1, 2, 3])


@pytest.mark.parametrize(
    "value",
    [
        POSE,
        {"location": {"x": 1, "y": 2, "z": 3}, "rotation": [4, 5, 6]},
        {"location": [1, 2, 3], "rotation": {"yaw": 5, "pitch": 4, "roll": 6}},
        Transform((1, 2, 3), (4, 5, 6)),
    ],
)
def test_transform_is_parsed_from_four_notations(value):
    assert as_transform(value) == Transform((1, 2, 3), (4, 5, 6))
    assert as_transform(value).as_dict() == POSE


@pytest.mark.parametrize(
    "location", [{"z": 3, "y": 2, "x": 1}, [1, 2, 3], np.array([1, 2, 3], np.float32)]
)
def test_vector_has_several_forms_and_missing_angles_are_zero(location):
    pose = as_transform({"location": location})
    turned = as_transform({"location": location, "rotation": {"yaw": 90}})

    assert (pose.location, pose.rotation) == ((1, 2, 3), (0, 0, 0))
    assert turned.rotation == (0, 90, 0)
    assert as_transform({"x": 1, "y": 2, "z": 3}) == pose


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ({"x": 1, "y": 2}, "transform.z: expected a number, found nothing"),
        (
            {**POSE, "yall": 9},
            "transform.yall: expected only x, y, z, pitch, yaw, roll",
        ),
        ({"rotation": [1, 2, 3]}, "transform.location: expected {x, y, z} or a list"),
        ({"location": [1, 2]}, "transform.location: expected a list of 3 numbers"),
        ([1, 2, 3], "transform: expected an object (a transform), found a list of 3"),
    ],
)
def test_invalid_transform_error_says_what_was_expected(value, words):
    with pytest.raises(AnnotationErrors) as fault:
        as_transform(value)

    assert words in fault.value.errors[0].detail


@pytest.mark.parametrize("fov", [0, -10, 180, 270, float("nan")])
def test_invalid_field_of_view_or_size_is_refused(fov):
    with pytest.raises(FilterError, match=r"camera\.fov: expected degrees") as fault:
        Camera.from_fov(1280, 720, fov, POSE)

    assert (fault.value.kind, fault.value.pointer) == ("bad_camera", "/camera/fov")
    for width, height in ((0, 720), (1280, -1)):
        with pytest.raises(FilterError, match="expected at least 1 px"):
            Camera.from_fov(width, height, 90, POSE)


OPENCV = [[0, 1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]


@pytest.mark.parametrize(
    ("intrinsic", "motion", "words"),
    [
        ([[1, 0], [0, 1]], np.eye(4), "intrinsic: expected 3 rows of 3 numbers"),
        (K, np.eye(3), "world_to_camera: expected 4 rows of 4 numbers"),
        (K, np.full((4, 4), np.nan), "world_to_camera: expected finite numbers"),
        (np.diag([-1, 1, 1]), np.eye(4), "expected two focal lengths above 0"),
        (np.ones((3, 3)), np.eye(4), r"expected \[fx s cx; 0 fy cy; 0 0 1\]"),
        (K, 2 * np.eye(4), "expected a rotation and a shift"),
        (K, OPENCV, "expected CARLA's axes"),
    ],
)
def test_invalid_camera_matrices_are_refused(intrinsic, motion, words):
    with pytest.raises(FilterError, match=words):
        Camera.from_matrices(1280, 720, intrinsic, motion)
