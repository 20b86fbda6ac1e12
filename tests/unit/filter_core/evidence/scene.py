"""Small made-up sensors."""

from __future__ import annotations

import cv2
import numpy as np

from filter_core.geometry.box3d import CORNER_SIGNS


def depth_png(metres: np.ndarray) -> bytes:
    """CARLA's raw depth: red is the lowest byte."""
    steps = np.rint(np.asarray(metres) / 1000.0 * (2**24 - 1)).astype(np.int64)
    planes = [steps >> 16, steps >> 8 & 255, steps & 255]
    return _png(np.stack(planes, axis=-1))


def instance_png(tags: np.ndarray, ids: np.ndarray, *, swapped: bool = False) -> bytes:
    """CARLA's instance image: red is the tag, the id is green + 256 blue."""
    wide = np.asarray(ids, np.int64)
    bgr = np.stack([wide >> 8, wide & 255, np.asarray(tags)], axis=-1)
    return _png(bgr[..., ::-1] if swapped else bgr)


def box_ahead(distance: float, half: float, right: float = 0.0) -> np.ndarray:
    """(8, 3): a cube in front of a camera at the origin."""
    return np.asarray(CORNER_SIGNS * half + np.array([distance, right, 0.0]))


def _png(bgr: np.ndarray) -> bytes:
    return cv2.imencode(".png", bgr.astype(np.uint8))[1].tobytes()
