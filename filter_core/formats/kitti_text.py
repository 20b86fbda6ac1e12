"""Lines of KITTI label files and calibrations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from filter_core.errors import FilterError, LayoutError
from filter_core.formats.kitti_box3d import kitti_vertices
from filter_core.formats.label_numbers import read_columns
from filter_core.geometry.camera import Camera
from filter_core.types import FloatArray

_COLUMNS: Final = (15, 16)

_DONT_CARE: Final = "dontcare"

_UNKNOWN: Final = -999.0
"""Locations below are KITTI's way to say that there is none."""


@dataclass(frozen=True)
class KittiLine:
    """One object: its type and its 14 numbers, or 15 with a score."""

    type: str
    numbers: tuple[float, ...]

    @property
    def xyxy(self) -> list[float]:
        """Left, top, right, bottom."""
        return list(self.numbers[3:7])

    @property
    def is_region(self) -> bool:
        """Whether it only says where not to look."""
        return self.type.lower() == _DONT_CARE

    @property
    def has_rectangle(self) -> bool:
        """Whether its rectangle has an extent."""
        x_min, y_min, x_max, y_max = self.xyxy
        return x_max > x_min and y_max > y_min

    @property
    def vertices(self) -> FloatArray | None:
        """(8, 3) metres in CARLA's axes of the labels' camera; None if not known."""
        height, width, length, x, y, z, rotation = self.numbers[7:14]
        if min(height, width, length) <= 0 or min(x, y, z) < _UNKNOWN:
            return None
        return kitti_vertices((height, width, length), (x, y, z), rotation)


def read_kitti_lines(text: str, name: str) -> list[KittiLine]:
    """The lines of one label file; `LayoutError` names file and line."""
    lines = []
    for number, line in enumerate(text.splitlines(), start=1):
        columns = line.split()
        if columns:
            lines.append(_line(columns, f"{name}, line {number}"))
    return lines


def read_calibration(text: str, name: str, wh: tuple[int, int]) -> Camera:
    """The left colour camera (``P2``) of one calibration file.

    The world is the labels' own frame, in CARLA's axes.

    Raises
    ------
    LayoutError
        No ``P2``, or it is no camera.
    """
    rows = [line.partition(":") for line in text.splitlines()]
    found = [value for key, _, value in rows if key.strip() == "P2"]
    if not found:
        raise LayoutError(f"{name}: expected a line 'P2:', found none")
    numbers = read_columns(found[0].split(), f"{name}, P2")
    if len(numbers) != 12:
        raise LayoutError(f"{name}, P2: expected 12 numbers, found {len(numbers)}")
    projection = np.array(numbers).reshape(3, 4)
    try:
        right, down, forward = np.linalg.solve(projection[:, :3], projection[:, 3])
        motion = np.eye(4)
        motion[:3, 3] = forward, right, -down
        return Camera.from_matrices(*wh, projection[:, :3], motion)
    except (FilterError, np.linalg.LinAlgError) as exc:
        raise LayoutError(f"{name}, P2: not a camera: {exc}") from exc


def box_of(line: KittiLine, camera: Camera | None) -> dict[str, Any]:
    """A line as a box of an annotation; the other columns are kept under ``kitti``.

    The rectangle counts where there is one. A line that has only a 3D box, as some
    tools write, needs the camera.
    """
    truncated, occluded, alpha = line.numbers[:3]
    box: dict[str, Any] = {"class": line.type}
    vertices = line.vertices
    if not line.has_rectangle and vertices is not None and camera is not None:
        return {**box, "vertices": vertices.tolist()}
    box["xyxy"] = line.xyxy
    kept: dict[str, Any] = {
        "truncated": truncated,
        "occluded": int(occluded) if occluded.is_integer() else occluded,
        "alpha": alpha,
    }
    if vertices is not None:
        box["distance"] = _distance(vertices, camera)
        kept["dimensions"] = list(line.numbers[7:10])
        kept["location"] = list(line.numbers[10:13])
        kept["rotation_y"] = line.numbers[13]
    if len(line.numbers) > 14:
        kept["score"] = line.numbers[14]
    return {**box, "kitti": kept}


def _distance(vertices: FloatArray, camera: Camera | None) -> float:
    position = np.zeros(3) if camera is None else camera.position
    return round(float(np.linalg.norm(vertices.mean(axis=0) - position)), 4)


def _line(columns: Sequence[str], at: str) -> KittiLine:
    if len(columns) not in _COLUMNS:
        raise LayoutError(
            f"{at}: expected 15 columns (16 with a score), found {len(columns)}"
        )
    return KittiLine(columns[0], tuple(read_columns(columns[1:], at)))
