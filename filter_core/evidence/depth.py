"""CARLA's depth image as evidence: which pixels of a box are at the box's own depth.

`read_depth` reads the image. `fill_depth` compares the depths of each box's accepted
pixels with the depths that the box takes up (`depth_interval`). `center_gaps` compares
only the pixel at the box's centre.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from filter_core.errors import ImageError, file_context
from filter_core.evidence.silhouettes import AcceptedPixels
from filter_core.geometry.camera import Camera
from filter_core.geometry.projection import NEAR_PLANE, to_image_points
from filter_core.images.decoding import decode_color
from filter_core.images.header import MAX_SIDE, read_image_header, require_size
from filter_core.images.pixels import values_of
from filter_core.types import ChannelNumbers, FloatArray, IntArray, Mask

DEPTH_RANGE: Final = 1000.0
"""Metres: the largest depth that the image can hold, which is that of the sky."""

DEPTH_STEPS: Final = (1 << 24) - 1


@dataclass(frozen=True, eq=False)
class DepthImage:
    """A raw depth image.

    Attributes
    ----------
    pixels : (H, W, 3) uint8
        Blue, green, red: the highest byte first.
    """

    pixels: NDArray[np.uint8]

    @property
    def wh(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.pixels.shape[1], self.pixels.shape[0]

    def steps(self, region: tuple[slice, slice]) -> NDArray[np.int32]:
        """(h, w) int32: depth in steps of 1000 m / (2^24 - 1)."""
        packed = values_of(self.pixels[region])
        return np.bitwise_and(packed, DEPTH_STEPS, dtype=np.int32)

    def metres(self, region: tuple[slice, slice]) -> FloatArray:
        """(h, w) float64: planar depth, along the camera's axis."""
        return self.steps(region).astype(np.float64) * (DEPTH_RANGE / DEPTH_STEPS)


def read_depth(
    content: bytes,
    *,
    expected_wh: tuple[int, int] | None = None,
    max_side: int = MAX_SIDE,
) -> DepthImage:
    """Read a raw depth image of CARLA.

    Parameters
    ----------
    content : bytes of a PNG, RGB or RGBA
    expected_wh : (width, height), px
    max_side : int, px

    Returns
    -------
    DepthImage

    Raises
    ------
    ImageError
        ``depth_too_coarse``: 8 bits in all; ``lossy_depth``: a JPEG; ``bad_image``: it
        cannot be decoded; and what `read_image_header` raises.

    Notes
    -----
    ``metres = 1000 (R + 256 G + 65536 B) / (2^24 - 1)`` [1]_. An image that was
    converted for people has 256 steps: 3.9 m each, if they are even.

    References
    ----------
    .. [1] CARLA documentation, "Sensors reference", depth camera.
    """
    with file_context("depth"):
        header = read_image_header(content, max_side=max_side)
    if expected_wh is not None:
        require_size(header, expected_wh, what="the depth image", than="the image")
    if header.media_type != "image/png":
        raise ImageError(
            "the depth image: expected a PNG, found a JPEG, whose losses change metres",
            pointer="/depth",
            code="lossy_depth",
        )
    if header.color_model not in ("rgb", "rgba") or header.bit_depth != 8:
        raise ImageError(
            "the depth image: expected CARLA's raw depth (RGB or RGBA, 24 bits), found "
            f"{header.color_model} with {header.bit_depth} bits: 256 steps of 3.9 m "
            "tell no car from the one behind it; save the image without a converter",
            pointer="/depth",
            code="depth_too_coarse",
        )
    with file_context("depth"):
        pixels = decode_color(content, header, "bgr")
    if pixels is None:
        raise ImageError("the depth image cannot be decoded: it is damaged")
    return DepthImage(np.asarray(pixels, np.uint8))


def fill_depth(
    numbers: ChannelNumbers,
    accepted: Sequence[AcceptedPixels],
    depth: DepthImage,
    interval: FloatArray,
) -> None:
    """Fill the columns that the depth image measures of 3D boxes.

    Parameters
    ----------
    numbers : ChannelNumbers
        Filled: `depth_pixels`, `depth_gap`, `nearer_percent`, and `tight_xyxy` where it
        is still NaN.
    accepted : those of the boxes that are in the image
    depth : DepthImage
    interval : (N, 2) float64, metres
        Nearest and farthest depth of each 3D box, tolerance included; NaN: not 3D.
    """
    low, high = step_interval(interval)
    for pixels in accepted:
        outline = pixels.silhouette
        row = outline.row
        if np.isnan(interval[row, 0]):
            continue
        steps = depth.steps(outline.region)
        nearer = steps < low[row]
        seen = pixels.mask & ~nearer & (steps <= high[row])
        numbers.depth_pixels[row] = np.count_nonzero(seen)
        covered = np.count_nonzero(outline.of(nearer))
        numbers.nearer_percent[row] = 100.0 * covered / outline.pixels
        if not numbers.depth_pixels[row]:
            numbers.depth_gap[row] = _gap(steps[pixels.mask], low[row], high[row])
        if np.isnan(numbers.tight_xyxy[row, 0]):
            numbers.tight_xyxy[row] = tight_rectangle(seen, outline.x0, outline.y0)


def step_interval(interval: FloatArray) -> tuple[IntArray, IntArray]:
    """(N,), (N,): first and last step of the depth image inside each interval."""
    steps = np.nan_to_num(interval, nan=0.0) * (DEPTH_STEPS / DEPTH_RANGE)
    bounded = np.clip(steps, -1, DEPTH_STEPS + 1)
    return np.ceil(bounded[:, 0]).astype(np.int64), np.floor(bounded[:, 1]).astype(
        np.int64
    )


def _gap(steps: NDArray[np.int32], low: int, high: int) -> float:
    """Metres from the median of `steps` to the interval: 0 inside, NaN if empty."""
    if not len(steps):
        return float("nan")
    middle = float(np.median(steps))
    gap = low - middle if middle < low else min(high - middle, 0.0)
    return gap * DEPTH_RANGE / DEPTH_STEPS


def tight_rectangle(mask: Mask, x0: int, y0: int) -> FloatArray:
    """(4,) px: rectangle around a mask's pixels, NaN if none; its corner is x0, y0."""
    rows = np.flatnonzero(mask.any(axis=1))
    if not len(rows):
        return np.full(4, np.nan)
    columns = np.flatnonzero(mask.any(axis=0))
    left, right = columns[0] + x0, columns[-1] + x0 + 1
    return np.array([left, rows[0] + y0, right, rows[-1] + y0 + 1], np.float64)


def depth_interval(
    vertices: FloatArray, camera: Camera, tolerance: float
) -> FloatArray:
    """(N, 2) metres: least and greatest planar depth of 3D boxes, with `tolerance`.

    NaN rows stay NaN. Only relative poses matter: moving the camera and the world
    together changes nothing.
    """
    depth = to_image_points(vertices, camera)[..., 2]
    near = np.maximum(depth.min(axis=1), NEAR_PLANE) - tolerance
    far = depth.max(axis=1) + tolerance
    return np.stack([near, far], axis=1)


def center_gaps(vertices: FloatArray, camera: Camera, depth: DepthImage) -> FloatArray:
    """How far the surface at each 3D box's projected centre is in front of the box.

    Parameters
    ----------
    vertices : (N, 8, 3) float64, metres; NaN rows for boxes that are not 3D
    camera : Camera
    depth : DepthImage

    Returns
    -------
    (N,) float64, metres
        Above 0: the surface is nearer than the nearest point of the box. NaN where the
        centre is not in the image, or the box not 3D.

    Notes
    -----
    One pixel stands for the whole box. This is the depth filter that the paper compares
    itself with; it is wrong whenever something thin crosses the centre.
    """
    gaps = np.full(len(vertices), np.nan)
    centre = to_image_points(vertices.mean(axis=1, keepdims=True), camera)[:, 0]
    near = depth_interval(vertices, camera, 0.0)[:, 0]
    width, height = depth.wh
    for row in np.flatnonzero(centre[:, 2] > NEAR_PLANE).tolist():
        u, v = np.floor(centre[row, :2] / centre[row, 2])
        if 0 <= u < width and 0 <= v < height:
            pixel = np.s_[int(v) : int(v) + 1, int(u) : int(u) + 1]
            gaps[row] = near[row] - depth.metres(pixel)[0, 0]
    return gaps
