"""Rectangles in pixels: five notations, correction (Algorithm 1), pixels they touch.

`to_xyxy` converts rectangles from any of the notations, `correct_xyxy` undoes the
rounding of their edges, clamps them to the image and finds those that cannot be
measured, and `pixel_bounds` returns the pixels that the others touch. No 3D here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from filter_core.arrays import BoolArray, BoxesXYXY, FloatArray, IntArray
from filter_core.errors import AnnotationError, FilterError
from filter_core.evidence_numbers import BoxState
from filter_core.verdicts import Profile


def _centre_size_to_corners(boxes: FloatArray) -> FloatArray:
    half = boxes[:, 2:] / 2
    return np.hstack([boxes[:, :2] - half, boxes[:, :2] + half])


_TO_XYXY: Final[dict[str, Callable[[FloatArray], FloatArray]]] = {
    "xyxy": lambda boxes: boxes,
    "xyxyn": lambda boxes: boxes,
    "xywh": lambda boxes: np.hstack([boxes[:, :2], boxes[:, :2] + boxes[:, 2:]]),
    "cxcywh": _centre_size_to_corners,
    "cxcywhn": _centre_size_to_corners,
}

FORMS: Final = tuple(_TO_XYXY)
"""The notations in which a rectangle can be given."""


def to_xyxy(form: str, values: ArrayLike, wh: tuple[int, int]) -> BoxesXYXY:
    """(N, 4) float64, px: rectangles of any form as half-open ``xyxy``, in a new array.

    Parameters
    ----------
    form : {"xyxy", "xyxyn", "xywh", "cxcywh", "cxcywhn"}
        Trailing ``n``: shares of the image's width and height instead of pixels.
    values : (N, 4)
        Anything numpy converts to float64. Inverted and non-finite boxes are not
        refused here but by `correct_xyxy`.
    wh : (width, height) of the image, px

    Raises
    ------
    FilterError
        ``bad_form``: the form is not one of the five; ``bad_shape``: not four columns.
    """
    boxes = _as_boxes(values)
    if form not in _TO_XYXY:
        raise FilterError(
            f"form: expected one of {', '.join(FORMS)}, found {form!r}", code="bad_form"
        )
    size = [*wh, *wh] if form.endswith("n") else [1, 1, 1, 1]
    return _TO_XYXY[form](boxes * np.array(size, dtype=np.float64))


EDGE_TOLERANCE: Final = 0.01
"""px: an edge that is this near to a whole number is that number.

Formats of labels round: six decimals of a share are up to 0.001 px in an image that is
2,000 px wide, and KITTI's two decimals 0.005 px.
"""

_FLOAT_ERROR: Final = 1e-9
"""px: by so much the difference of two float64 coordinates may be wrong."""


def correct_xyxy(
    xyxy: ArrayLike,
    wh: tuple[int, int],
    profile: Profile = "paper",
    *,
    rounded_edges: bool = True,
) -> tuple[BoxesXYXY, NDArray[np.uint8]]:
    """Correct the coordinates of boxes (Algorithm 1), and return the state of each.

    (N, 4) float64, px: clamped to the image; NaN rows for boxes outside the image or
    degenerate. And (N,) uint8, `BoxState`.

    Parameters
    ----------
    xyxy : (N, 4), px
        As given: may reach out of the image, be inverted, or have no area.
    wh : (width, height) of the image, px
    rounded_edges : bool
        Whether the rounding of edges is undone (see Notes); never in profile
        ``carlasimu``. False for numbers that were measured before this was done.

    Raises
    ------
    AnnotationError
        ``not_finite``: a coordinate is NaN or infinite; the text names the box.
    FilterError
        ``bad_shape``, ``bad_profile``.

    Notes
    -----
    First, in profile ``paper``, an edge within `EDGE_TOLERANCE` of a whole number
    becomes that number, so that a box has the same pixels in every format of labels. It
    stays as it is where both edges of an axis would become the same number, since
    undoing a rounding must not take a box's extent away.

    Then, in this order: strictly outside on either axis (min > size or max < 0) is
    ``OUTSIDE_IMAGE``; clamp; an extent of zero or less afterwards, inverted boxes
    included, is ``DEGENERATE``. Profile ``carlasimu`` differs in two ways, as its code
    does: ``x_min >= width`` is outside too (on x only), and a corrected box whose area
    reaches the image's is ``COVERS_IMAGE``.

    References
    ----------
    .. [1] M. Chaar, J. Raiyn, G. Weidl, "Improve Bounding Box in Carla Simulator",
       VEHITS 2024, Algorithm 1.
    """
    if profile not in get_args(Profile):
        expected = " or ".join(get_args(Profile))
        raise FilterError(
            f"profile: expected {expected}, found {profile!r}", code="bad_profile"
        )
    boxes = _as_boxes(xyxy)
    finite = np.isfinite(boxes).all(axis=1)
    if not finite.all():
        index = int(np.argmin(finite))
        raise AnnotationError(
            f"box {index}: expected four finite numbers, found {boxes[index].tolist()}",
            pointer=f"/boxes/{index}",
            code="not_finite",
        )
    limit = np.array([*wh, *wh], dtype=np.float64)
    if profile == "paper" and rounded_edges:
        # Edges that were rounded become the whole numbers that they were.
        whole = np.rint(boxes) + 0.0  # not -0.0
        distance = np.abs(boxes - whole)
        is_rounded = (distance > 0) & (distance <= EDGE_TOLERANCE + _FLOAT_ERROR)
        if is_rounded.any():
            edges = np.where(is_rounded, whole, boxes)
            is_lost = (edges[:, :2] == edges[:, 2:]) & (boxes[:, :2] != boxes[:, 2:])
            boxes = np.where(np.hstack([is_lost, is_lost]), boxes, edges)
    corrected: BoxesXYXY = np.minimum(np.maximum(boxes, 0.0), limit)
    extent = corrected[:, 2:] - corrected[:, :2]
    area = extent[:, 0] * extent[:, 1]
    as_carlasimu = profile == "carlasimu"
    x_min, y_min, x_max, y_max = boxes.T
    width, height = wh
    right_of_image = x_min >= width if as_carlasimu else x_min > width
    outside: BoolArray = right_of_image | (y_min > height) | (x_max < 0) | (y_max < 0)
    degenerate = (extent[:, 0] <= 0) | (extent[:, 1] <= 0)
    covers = np.zeros(len(boxes), dtype=np.bool_)
    if as_carlasimu:
        # The area of a sliver can underflow to 0, which the published code tests for.
        degenerate |= area == 0
        covers = area >= wh[0] * wh[1]

    # The first rule is written last, so it wins; much faster than np.select.
    state = np.full(len(boxes), BoxState.MEASURABLE, np.uint8)
    state[covers] = BoxState.COVERS_IMAGE
    state[degenerate] = BoxState.DEGENERATE
    state[outside] = BoxState.OUTSIDE_IMAGE
    corrected[outside | degenerate] = np.nan
    return corrected, state


def pixel_bounds(xyxy: ArrayLike, wh: tuple[int, int]) -> IntArray:
    """(N, 4) int64: the pixels that boxes touch.

    As first column, first row, last column + 1, last row + 1 within the image: columns
    ``floor(x_min) .. ceil(x_max) - 1``, rows likewise. A box thinner than a pixel still
    has one; a NaN row has none: ``0 0 0 0``. `xyxy` (N, 4) are corrected boxes, px;
    `wh` is (width, height) of the image, px.
    """
    boxes = _as_boxes(xyxy)
    # A NaN cast to an integer is undefined, so those rows are replaced before.
    has_corners = ~np.isnan(boxes).any(axis=1, keepdims=True)
    solid = boxes if has_corners.all() else np.where(has_corners, boxes, 0.0)
    size = np.array(wh, dtype=np.float64)
    bounds = np.empty(boxes.shape, dtype=np.int64)
    first = np.minimum(np.maximum(np.floor(solid[:, :2]), 0), size - 1)
    bounds[:, :2] = first
    bounds[:, 2:] = np.minimum(np.maximum(np.ceil(solid[:, 2:]), first + 1), size)
    bounds *= has_corners
    return bounds


def pairwise_iou(first: BoxesXYXY, second: BoxesXYXY) -> FloatArray:
    """(N, M) float64: intersection over union of (N, 4) and (M, 4) rectangles.

    0 where they do not overlap, also for rectangles without area.
    """
    low = np.maximum(first[:, None, :2], second[None, :, :2])
    high = np.minimum(first[:, None, 2:], second[None, :, 2:])
    sides = np.maximum(high - low, 0.0)
    shared = sides[..., 0] * sides[..., 1]
    areas = [np.prod(each[:, 2:] - each[:, :2], axis=1) for each in (first, second)]
    total = areas[0][:, None] + areas[1][None] - shared
    share: FloatArray = np.zeros_like(shared)
    np.divide(shared, total, out=share, where=shared > 0)
    return share


def _as_boxes(values: ArrayLike) -> FloatArray:
    boxes = np.asarray(values, dtype=np.float64)
    if boxes.size == 0:
        return boxes.reshape(0, 4)
    if boxes.ndim != 2 or boxes.shape[1] != 4:
        raise FilterError(
            f"boxes: expected an array of shape (N, 4), found {boxes.shape}",
            code="bad_shape",
        )
    return boxes
