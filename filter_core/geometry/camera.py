"""The pinhole camera of a frame: where it stands and how it maps metres to pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from filter_core.arrays import FloatArray
from filter_core.errors import FilterError
from filter_core.geometry.pose import TransformLike, as_transform

CARLA_TO_IMAGE_AXES: Final[FloatArray] = np.array(
    [[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]
)
"""CARLA's camera axes (forward, right, up) to the image's (right, down, forward)."""

_RIGID_TOLERANCE: Final = 1e-3
"""CARLA's own matrices are float32, and people round what they write to files."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera without distortion.

    Attributes
    ----------
    width, height : int, px
    intrinsic : (3, 3) float64
        ``K``; pixel (i, j) covers ``[j, j+1) x [i, i+1)``.
    world_to_camera : (4, 4) float64
        From the world to CARLA's camera axes: x forward, y right, z up.
    """

    width: int
    height: int
    intrinsic: FloatArray
    world_to_camera: FloatArray

    @classmethod
    def from_fov(
        cls, width: int, height: int, fov: float, transform: TransformLike
    ) -> Camera:
        """A CARLA camera, from its blueprint's attributes and its transform.

        Parameters
        ----------
        width, height : int, px
        fov : float, degrees
            The horizontal field of view, between 0 and 180.
        transform : Transform, or an object
            ``{x, y, z, pitch, yaw, roll}`` or ``{location, rotation}``.

        Raises
        ------
        FilterError
            ``bad_camera``: a size or the field of view is impossible.
        AnnotationErrors
            The transform cannot be read.
        """
        _check_size(width, height)
        if not 0 < fov < 180:
            raise _fault("fov", "degrees between 0 and 180", fov)
        world_to_camera = as_transform(transform).inverse_matrix
        focal = width / (2 * math.tan(math.radians(fov) / 2))
        intrinsic = np.array(
            [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]]
        )
        return cls(width, height, intrinsic, world_to_camera)

    @classmethod
    def from_matrices(
        cls, width: int, height: int, intrinsic: ArrayLike, world_to_camera: ArrayLike
    ) -> Camera:
        """A camera from its matrices, as CARLA's tutorials compute them.

        Parameters
        ----------
        width, height : int, px
        intrinsic : (3, 3)
        world_to_camera : (4, 4)
            ``camera.get_transform().get_inverse_matrix()``: CARLA's axes, not OpenCV's.

        Raises
        ------
        FilterError
            ``bad_camera``: a matrix has another shape, is not finite, is no projection,
            or is no rigid motion of CARLA's left-handed world.
        """
        _check_size(width, height)
        projection = _matrix("intrinsic", intrinsic, 3)
        motion = _matrix("world_to_camera", world_to_camera, 4)
        if projection[0, 0] <= 0 or projection[1, 1] <= 0:
            text = f"{projection[0, 0]:g} and {projection[1, 1]:g}"
            raise _fault("intrinsic", "two focal lengths above 0", text)
        if projection[1, 0] != 0 or not np.array_equal(projection[2], [0, 0, 1]):
            raise _fault("intrinsic", "[fx s cx; 0 fy cy; 0 0 1]", projection.tolist())
        rotation = motion[:3, :3]
        skew = np.abs(rotation @ rotation.T - np.eye(3)).max()
        last_row_off = np.abs(motion[3] - [0, 0, 0, 1]).max()
        if skew > _RIGID_TOLERANCE or last_row_off > _RIGID_TOLERANCE:
            raise _fault("world_to_camera", "a rotation and a shift", motion.tolist())
        if np.linalg.det(rotation) < 0:
            # OpenCV's right-handed axes mirror CARLA's: the determinant is -1.
            expected = "CARLA's axes (x forward, y right, z up)"
            text = "a mirrored matrix (OpenCV's axes?)"
            raise _fault("world_to_camera", expected, text)
        return cls(width, height, projection, motion)

    @cached_property
    def position(self) -> FloatArray:
        """(3,) float64, metres: where the camera stands in the world."""
        motion = self.world_to_camera
        position = np.linalg.solve(motion[:3, :3], -motion[:3, 3])
        return np.asarray(position, dtype=np.float64)

    @cached_property
    def world_to_image(self) -> FloatArray:
        """(3, 4) float64: world points to ``(u depth, v depth, depth)``."""
        axes = self.intrinsic @ CARLA_TO_IMAGE_AXES
        return axes @ self.world_to_camera[:3]


def _fault(field: str, expected: str, found: object) -> FilterError:
    return FilterError(
        f"camera.{field}: expected {expected}, found {found}",
        pointer=f"/camera/{field}",
        code="bad_camera",
    )


def _check_size(width: int, height: int) -> None:
    for field, value in (("width", width), ("height", height)):
        if value < 1:
            raise _fault(field, "at least 1 px", value)


def _matrix(field: str, value: ArrayLike, side: int) -> FloatArray:
    matrix = np.array(value, dtype=np.float64)
    if matrix.shape != (side, side):
        raise _fault(field, f"{side} rows of {side} numbers", f"shape {matrix.shape}")
    if not np.isfinite(matrix).all():
        raise _fault(field, "finite numbers", "NaN or an infinity")
    return matrix
