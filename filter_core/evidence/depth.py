"""Depth images as evidence: which pixels of a box are at the box's own depth.

`read_depth` reads the image and recognises how it holds metres; where its pixels alone
do not tell, `settled_depth` asks the boxes. `fill_depth` compares the depths of each
box's accepted pixels with the depths that the box takes up (`depth_interval`).
`center_gaps` compares only the pixel at the box's centre.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import FloatArray, IntArray, Mask
from filter_core.errors import ImageError, file_context
from filter_core.evidence.silhouettes import AcceptedPixels
from filter_core.evidence_numbers import ChannelNumbers, DepthEncoding
from filter_core.geometry.camera import Camera
from filter_core.geometry.projection import NEAR_PLANE, to_image_points
from filter_core.images.decoding import decode_color, decode_image
from filter_core.images.header import (
    MAX_SIDE,
    ImageHeader,
    header_of,
    require_size,
)
from filter_core.images.pixels import values_of

DEPTH_RANGE: Final = 1000.0
"""Metres: the largest depth that CARLA's image can hold, which is that of the sky."""

DEPTH_STEPS: Final = (1 << 24) - 1

_TOO_COARSE: Final = {
    "metres16": "steps of 1 m",
    "log8": "256 steps on a logarithmic scale",
    "linear8": "256 steps of 3.9 m",
}
"""Encodings whose steps tell no object from the one behind it."""


@dataclass(frozen=True, eq=False)
class DepthImage:
    """A depth image.

    Attributes
    ----------
    pixels : (H, W, 3) uint8, or (H, W) uint16
        Blue, green, red: the highest byte first; or millimetres.
    encoding : ``carla``, ``carla-bgr`` or ``millimetres16``
        Of the file. `pixels` of ``carla-bgr`` are in the right order already.
    is_certain : bool
        Whether its content or the caller says so; else the boxes have to confirm it.
    """

    pixels: NDArray[np.uint8] | NDArray[np.uint16]
    encoding: DepthEncoding = "carla"
    is_certain: bool = True

    @property
    def wh(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.pixels.shape[1], self.pixels.shape[0]

    @property
    def is_wide(self) -> bool:
        """Whether it has one channel of 16 bits: too few for all depths of a street."""
        return self.pixels.ndim == 2

    def can_tell(self, steps: NDArray[np.int32], farthest: float) -> bool:
        """Whether it says which of some pixels are as far away as an object.

        16 bits end at 65.535 m, and 0 is "not known" there. `steps` are those of the
        pixels, `farthest` is the step of the object's farthest point.
        """
        return not self.is_wide or (farthest <= _LAST_OF_16 and bool(steps.all()))

    def steps(self, region: tuple[slice, slice]) -> NDArray[np.int32]:
        """(h, w) int32: depth in steps of 1000 m / (2^24 - 1)."""
        pixels = self.pixels[region]
        if self.is_wide:
            wide: NDArray[np.int32] = np.rint(pixels * _STEPS_PER_MM).astype(np.int32)
            return wide
        packed = values_of(pixels.astype(np.uint8, copy=False))
        steps: NDArray[np.int32] = np.bitwise_and(packed, DEPTH_STEPS, dtype=np.int32)
        return steps

    def metres(self, region: tuple[slice, slice]) -> FloatArray:
        """(h, w) float64: planar depth, along the camera's axis."""
        return self.steps(region).astype(np.float64) * (DEPTH_RANGE / DEPTH_STEPS)

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know about the reading."""
        if self.encoding == "carla":
            return ()
        if self.encoding == "carla-bgr":
            return ("red and blue are swapped in the depth image; read as carla-bgr",)
        return (
            "the depth image is read as millimetres16; depth does not judge boxes "
            "beyond 65.535 m",
        )


_STEPS_PER_MM: Final = DEPTH_STEPS / (1000.0 * DEPTH_RANGE)

_LAST_OF_16: Final = np.iinfo(np.uint16).max * _STEPS_PER_MM


def read_depth(
    content: bytes | NDArray[np.uint8],
    encoding: DepthEncoding = "auto",
    *,
    expected_wh: tuple[int, int] | None = None,
    max_side: int = MAX_SIDE,
) -> DepthImage:
    """Read a depth image.

    Parameters
    ----------
    content : bytes of a PNG, or (H, W, 3) uint8
        RGB or RGBA of 8 bits, as CARLA writes it, or grey of 16 bits. Pixels are blue,
        green and red.
    expected_wh : (width, height), px
    max_side : int, px

    Raises
    ------
    ImageError
        ``depth_too_coarse``: 8 bits in all, or steps of a metre; ``lossy_depth``: a
        JPEG; ``unknown_depth``: it holds no metres in a way that is known; or
        ``bad_image``: it cannot be decoded; and what `read_image_header` raises.

    Notes
    -----
    ``metres = 1000 (R + 256 G + 65536 B) / (2^24 - 1)`` [1]_. An image that was
    converted for people has 256 steps: 3.9 m each, if they are even.

    The order of the bytes is told from how much they differ between pixels side by
    side: the highest hardly does, the lowest almost always, and by any amount.

    References
    ----------
    .. [1] CARLA documentation, "Sensors reference", depth camera.
    """
    with file_context("depth"):
        header = header_of(content, max_side)
    if expected_wh is not None:
        require_size(header, expected_wh, what="the depth image", than="the image")
    _refuse_form(header, encoding)
    if isinstance(content, np.ndarray):
        return _in_order(content, encoding)
    is_wide = header.bit_depth == 16
    with file_context("depth"):
        pixels = (
            decode_image(content, header, cv2.IMREAD_UNCHANGED)
            if is_wide
            else decode_color(content, header, "bgr")
        )
    if pixels is None:
        raise ImageError("the depth image cannot be decoded: it is damaged")
    if is_wide:
        wide = pixels.astype(np.uint16, copy=False)
        return DepthImage(wide, "millimetres16", encoding != "auto")
    return _in_order(pixels, encoding)


def _refuse_form(header: ImageHeader, encoding: DepthEncoding) -> None:
    """Refuse what cannot hold metres well enough, or not in the encoding named."""
    if header.media_type != "image/png":
        raise ImageError(
            "the depth image: expected a PNG, found a JPEG, whose losses change metres",
            pointer="/depth",
            code="lossy_depth",
        )
    form = f"{header.color_model} with {header.bit_depth} bits"
    if encoding in _TOO_COARSE:
        raise _too_coarse(f"depth_encoding {encoding}: {_TOO_COARSE[encoding]}")
    if header.color_model in ("grey", "grey_alpha") and header.bit_depth <= 8:
        raise _too_coarse(f"{form}: {_TOO_COARSE['linear8']}, if they are even,")
    is_color = header.color_model in ("rgb", "rgba") and header.bit_depth == 8
    is_wide = header.color_model == "grey" and header.bit_depth == 16
    if encoding == "auto" and (is_color or is_wide):
        return
    if is_color and encoding in ("carla", "carla-bgr"):
        return
    if is_wide and encoding == "millimetres16":
        return
    named = "" if encoding == "auto" else f" for depth_encoding {encoding}"
    of_16 = encoding in ("auto", "millimetres16")
    of_24 = encoding != "millimetres16"
    expected = ["RGB or RGBA with 8 bits"] * of_24 + ["grey with 16 bits"] * of_16
    raise _unknown(f"expected {' or '.join(expected)}{named}, found {form}")


def _too_coarse(levels: str) -> ImageError:
    return ImageError(
        f"the depth image: expected CARLA's raw depth (RGB or RGBA, 24 bits), found "
        f"{levels} tell no car from the one behind it; save the image without a "
        "converter",
        pointer="/depth",
        code="depth_too_coarse",
    )


def _unknown(text: str) -> ImageError:
    return ImageError(
        f"the depth image: {text}", pointer="/depth", code="unknown_depth"
    )


_SAMPLED_PAIRS: Final = 4096
_FEWEST_PAIRS: Final = 64

_FLAT_SHARE: Final = 0.05
"""Pairs of pixels that differ: fewer in drawn scenes, instances and segmentations."""

_ROUGH_STEP: Final = 16
_LEAST_ROUGH: Final = 0.2
"""Share of differing pairs whose lowest byte differs by more than `_ROUGH_STEP`.

Of raw depth: mostly above 0.8, in drawn scenes from 0.5. Of photos: below 0.1.
"""

_ROUGHER: Final = 0.2
"""By so much more of the pairs the lowest byte is rough than the middle one, at least.

Only on steep surfaces, where both are noise, is the difference less.
"""

_MOST_OF_IT: Final = 1 / 3
"""The same share of the highest byte may be so much of it; it is hardly above 0.02.

In images of other sensors, and in colour maps, the two are about the same.
"""


def _in_order(bgr: NDArray[np.uint8], named: DepthEncoding) -> DepthImage:
    """A coloured image in the order of channels that is named, or that it shows."""
    # Some pixels, and how much those beside and below them differ, all (3, P)
    height, width, _ = bgr.shape
    step = max(1, int((2 * height * width / _SAMPLED_PAIRS) ** 0.5))
    pixels = _planes(bgr[: height - 1 : step, : width - 1 : step])
    beside = []
    for shifted in (
        bgr[1::step, : width - 1 : step],
        bgr[: height - 1 : step, 1::step],
    ):
        other = _planes(shifted)
        seen = (pixels & other != _WHITE).any(axis=0)
        beside.append((other - pixels)[:, seen])
    differences = np.concatenate(beside, axis=1)
    # Black and white are depths, too: 0 m and the sky's 1000 m.
    is_shade = (pixels == pixels[0]).all(axis=0)
    if is_shade.all() and ((pixels > 0) & (pixels < 255)).any():
        raise _too_coarse(
            "8 bits, three times the same: 256 steps, even or logarithmic,"
        )
    depth = DepthImage(bgr)
    differing = differences[:, differences.any(axis=0)]
    fewest = max(_FEWEST_PAIRS, _FLAT_SHARE * differences.shape[1])
    if differing.shape[1] < fewest:
        if named == "auto":
            return replace(depth, is_certain=False)
        return depth if named == "carla" else _swapped(depth)
    shown, changes = _shown_order(differing)
    if shown == named == "auto":
        raise _unknown(
            "expected CARLA's raw depth, in which blue changes little from pixel to "
            f"pixel and red much, found {changes}, as in a photo, a colour map or an "
            "image of another sensor. If it is depth, name its depth_encoding"
        )
    if named != "auto" and shown not in ("auto", named):
        raise _unknown(f"depth_encoding says {named}, {changes} prove {shown}")
    return _swapped(depth) if "carla-bgr" in (named, shown) else depth


def _shown_order(differences: NDArray[np.int16]) -> tuple[DepthEncoding, str]:
    """The order of channels that (3, P) differences of pixels show, and why."""
    levels = np.abs(differences)
    levels = np.minimum(levels, 256 - levels)  # a byte that overflows goes on at 0
    blue, green, red = (levels > _ROUGH_STEP).mean(axis=1).tolist()
    changes = f"changes of more than {_ROUGH_STEP} levels at"
    if green > max(red, blue) + _ROUGHER:
        raise _unknown(
            "expected CARLA's raw depth, in which red changes most (or blue, if they "
            f"are swapped), found {changes} {100 * green:.0f} % (green), "
            f"{100 * red:.0f} % (red) and {100 * blue:.0f} % (blue) of the pixels that "
            "change; its channels are exchanged in a way that is not known"
        )
    shown: DepthEncoding = "auto"
    if max(red, blue) >= _LEAST_ROUGH:
        if blue <= _MOST_OF_IT * red:
            shown = "carla"
        elif red <= _MOST_OF_IT * blue:
            shown = "carla-bgr"
    shares = f"{100 * blue:.0f} % (blue) and {100 * red:.0f} % (red)"
    return shown, f"{changes} {shares} of the pixels that change"


_WHITE: Final = 255


def _planes(bgr: NDArray[np.uint8]) -> NDArray[np.int16]:
    """(3, P) int16: the channels of some pixels, one after the other."""
    planes: NDArray[np.int16] = bgr.reshape(-1, 3).T.astype(np.int16, order="C")
    return planes


def _swapped(depth: DepthImage) -> DepthImage:
    """The same file, read with red and blue exchanged."""
    pixels = cv2.cvtColor(depth.pixels, cv2.COLOR_BGR2RGB).astype(np.uint8, copy=False)
    return replace(depth, pixels=pixels, encoding="carla-bgr")


_NO_STEPS: Final = np.empty(0, np.int32)


def settled_depth(
    depth: DepthImage, accepted: Sequence[AcceptedPixels], interval: FloatArray
) -> DepthImage:
    """The image, read as its boxes show where its content alone does not tell.

    Returned as it is if it is certain. `accepted` and `interval` are as for
    `fill_depth`.

    Raises
    ------
    ImageError
        ``unknown_depth``: no box, or of 16 bits not every second one, has its pixels at
        its own depth; or the pixels of all of several boxes are behind them; or they
        are at their depth in millimetres.

    Notes
    -----
    A box fits if half of its accepted pixels or more are at its depth. A hidden one
    does not, so that a single box speaks for one of two orders of channels; but numbers
    of 16 bits may be of any unit, and have to fit most boxes. What hides a box is in
    front of it, so that an image with the pixels of every box behind it has another
    unit than CARLA's.
    """
    low, high = step_interval(interval)
    boxes = [
        pixels
        for pixels in accepted
        if not np.isnan(interval[pixels.silhouette.row, 0])
        and depth.can_tell(_NO_STEPS, high[pixels.silhouette.row])
        and pixels.mask.any()
    ]
    if depth.is_certain:
        are_behind = (
            (
                depth.steps(pixels.silhouette.region)[pixels.mask]
                > high[pixels.silhouette.row]
            )
            for pixels in boxes
        )
        if len(boxes) > 1 and all(steps.all() for steps in are_behind):
            raise _unknown(
                f"its pixels are behind each of the {len(boxes)} boxes that they "
                "belong to: its numbers are not CARLA's, or the boxes of another frame"
            )
        if boxes and not any(
            _boxes_that_fit(depth, [pixels], low, high) for pixels in boxes
        ):
            of_millimetres = (low / _STEPS_PER_MM, high / _STEPS_PER_MM)
            if 2 * _boxes_that_fit(depth, boxes, *of_millimetres) >= len(boxes):
                raise _unknown(
                    "its pixels are at the depth of their boxes if its 24 bits are "
                    "millimetres; expected steps of 1000 m / (2^24 - 1), as CARLA "
                    "writes them, or 16 bits for millimetres"
                )
        return depth
    is_color = not depth.is_wide
    if not boxes and (is_color or np.isnan(interval[:, 0]).all()):
        return depth
    readings = [depth, _swapped(depth)] if is_color else [depth]
    fits = [_boxes_that_fit(reading, boxes, low, high) for reading in readings]
    most = max(fits)
    if most and (is_color or 2 * most >= len(boxes)):
        return readings[fits.index(most)]
    if is_color:
        raise _unknown(
            "its pixels are at the depth of none of the boxes that they belong to, in "
            "either order of channels, and it is too flat to tell what it is; if it is "
            "depth, name its depth_encoding"
        )
    raise _unknown(
        f"read as millimetres, its 16 bits are at the depth of {most} of {len(boxes)} "
        "boxes that pixels belong to; expected most of them. If it is in millimetres, "
        "name depth_encoding millimetres16"
    )


def _boxes_that_fit(
    depth: DepthImage,
    boxes: Sequence[AcceptedPixels],
    low: IntArray | FloatArray,
    high: IntArray | FloatArray,
) -> int:
    """How many boxes have half of their accepted pixels or more at their own depth."""
    fitting = 0
    for pixels in boxes:
        row = pixels.silhouette.row
        steps = depth.steps(pixels.silhouette.region)[pixels.mask]
        own = np.count_nonzero((steps >= low[row]) & (steps <= high[row]))
        fitting += 2 * own >= len(steps)
    return fitting


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
    interval : (N, 2) float64, metres
        Nearest and farthest depth of each 3D box, tolerance included; NaN: not 3D.

    Notes
    -----
    Boxes about which the image cannot tell (`DepthImage.can_tell`) stay unmeasured.
    """
    low, high = step_interval(interval)
    for pixels in accepted:
        outline = pixels.silhouette
        row = outline.row
        if np.isnan(interval[row, 0]):
            continue
        steps = depth.steps(outline.region)
        if not depth.can_tell(steps[pixels.mask], high[row]):
            continue
        nearer = steps < low[row]
        seen = pixels.mask & ~nearer & (steps <= high[row])
        numbers.depth_pixels[row] = np.count_nonzero(seen)
        covered = np.count_nonzero(outline.of(nearer))
        numbers.nearer_percent[row] = 100.0 * covered / outline.pixels
        own = steps[pixels.mask]
        if not numbers.depth_pixels[row] and len(own):
            # Metres from the median of the accepted pixels to the interval: 0 inside
            middle = float(np.median(own))
            below, above = low[row] - middle, high[row] - middle
            gap = below if below > 0 else min(above, 0.0)
            numbers.depth_gap[row] = gap * DEPTH_RANGE / DEPTH_STEPS
        if np.isnan(numbers.tight_xyxy[row, 0]):
            numbers.tight_xyxy[row] = tight_rectangle(seen, outline.x0, outline.y0)


def step_interval(interval: FloatArray) -> tuple[IntArray, IntArray]:
    """(N,), (N,): first and last step of the depth image inside each interval."""
    steps = np.nan_to_num(interval, nan=0.0) * (DEPTH_STEPS / DEPTH_RANGE)
    bounded = np.clip(steps, -1, DEPTH_STEPS + 1)
    return np.ceil(bounded[:, 0]).astype(np.int64), np.floor(bounded[:, 1]).astype(
        np.int64
    )


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
    """(N,) float64, metres: how far the surface is in front of each 3D box.

    That is the surface at its projected centre. Above 0: the surface is nearer than the
    nearest point of the box. NaN where the centre is not in the image, the box not 3D
    (a NaN row of `vertices`, which are (N, 8, 3), metres), or the image cannot tell.

    Notes
    -----
    One pixel stands for the whole box. This is the depth filter that the paper compares
    itself with; it is wrong whenever something thin crosses the centre.
    """
    gaps = np.full(len(vertices), np.nan)
    centre = to_image_points(vertices.mean(axis=1, keepdims=True), camera)[:, 0]
    interval = depth_interval(vertices, camera, 0.0)
    farthest = step_interval(interval)[1]
    width, height = depth.wh
    for row in np.flatnonzero(centre[:, 2] > NEAR_PLANE).tolist():
        u, v = np.floor(centre[row, :2] / centre[row, 2])
        if 0 <= u < width and 0 <= v < height:
            pixel = np.s_[int(v) : int(v) + 1, int(u) : int(u) + 1]
            if depth.can_tell(depth.steps(pixel), farthest[row]):
                gaps[row] = interval[row, 0] - depth.metres(pixel)[0, 0]
    return gaps


class DepthSlice(NamedTuple):
    """Where a box and the pixels in its rectangle are on the axis of depth, in metres.

    `near` and `far` are those of a 3D box, else None; `median` is of the pixels, None
    if all are sky. `bands` are from, to and percent of the rectangle's pixels, from
    near to far; the sky is in none.
    """

    near: float | None
    far: float | None
    median: float | None
    bands: list[tuple[float, float, float]]


_BANDS: Final = 32


def depth_slice(
    depth: DepthImage, xyxy: Sequence[float], interval: FloatArray
) -> DepthSlice:
    """The depths in a rectangle that overlaps the image, px.

    It also has those that a 3D box takes up. `interval`, (2,) float64, metres, is as
    `depth_interval` gives it; NaN: the box is not 3D.
    """
    width, height = depth.wh
    left, top = (
        max(0, min(int(xyxy[0]), width - 1)),
        max(0, min(int(xyxy[1]), height - 1)),
    )
    right = min(width, max(left + 1, math.ceil(xyxy[2])))
    bottom = min(height, max(top + 1, math.ceil(xyxy[3])))
    metres = depth.metres(np.s_[top:bottom, left:right])
    seen = metres[(metres > 0) & (metres < DEPTH_RANGE - 1)]
    near, far = (None if at != at else round(float(at), 2) for at in interval)
    if not seen.size:
        return DepthSlice(near, far, None, [])
    low, high = max(0.1, float(seen.min()) * 0.98), float(seen.max()) * 1.02
    edges = np.geomspace(low, high, _BANDS + 1)
    counts, _ = np.histogram(seen, edges)
    bands = [
        (round(start, 2), round(end, 2), round(100 * count / metres.size, 2))
        for start, end, count in zip(
            edges[:-1].tolist(), edges[1:].tolist(), counts.tolist(), strict=True
        )
        if count
    ]
    return DepthSlice(near, far, round(float(np.median(seen)), 2), bands)
