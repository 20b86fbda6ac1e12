"""The order of boxes by distance as evidence, for the channel ``ordered``.

A pixel that a nearer box takes is no evidence for a box behind it. `owned_pixels` lets
the boxes of a frame take their accepted pixels, from near to far. `islands` are patches
that a box leaves to a box behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np

from filter_core.arrays import NOT_MEASURED, BoolArray, FloatArray, IntArray, Mask
from filter_core.evidence.silhouettes import AcceptedPixels

_UNCLAIMED: Final = -1


def owned_pixels(
    accepted: Sequence[AcceptedPixels],
    distance: FloatArray,
    ids: Sequence[str],
    image_wh: tuple[int, int],
) -> tuple[IntArray, IntArray]:
    """Let boxes take their accepted pixels, from near to far.

    (N,) int64, px: the accepted pixels of each box's silhouette that no nearer box has
    taken; `NOT_MEASURED` for boxes of unknown distance or outside the image. And (N,)
    int64: the row of the nearer box that has taken most of them (the nearest of
    several); `NOT_MEASURED` if none has taken any.

    Parameters
    ----------
    accepted : those of the boxes that are in the image
    distance : (N,) float64, metres
        Boxes of unknown distance (NaN) take no pixels and get no number.
    ids : of the N boxes
        Break ties of distance.
    image_wh : (width, height), px

    Notes
    -----
    A ghost in front takes nothing if it has no accepted pixels, so it does not hide
    boxes behind it. Two kinds of pixels count for a box and stay free for others:
    those whose centres are outside its outline, which cannot show it, and `islands`.
    """
    owned = np.full(len(distance), NOT_MEASURED, np.int64)
    explained_by = np.full(len(distance), NOT_MEASURED, np.int64)
    claims = np.full(image_wh[::-1], _UNCLAIMED, np.int32)
    # From near to far; ties are ordered by id
    ranked = sorted(
        (
            pixels
            for pixels in accepted
            if not np.isnan(distance[pixels.silhouette.row])
        ),
        key=lambda pixels: (
            distance[pixels.silhouette.row],
            ids[pixels.silhouette.row],
        ),
    )
    bounds = silhouette_bounds(ranked)
    for rank, pixels in enumerate(ranked):
        row = pixels.silhouette.row
        claimed = claims[pixels.silhouette.region]
        free = pixels.mask & (claimed == _UNCLAIMED)
        owned[row] = np.count_nonzero(free)
        if owned[row] < pixels.count:
            # The commonest rank; of several the lowest, which is the nearest box
            explained_by[row] = int(np.bincount(claimed[pixels.mask & ~free]).argmax())
        if owned[row]:
            taken = free & pixels.own
            left = islands(pixels, ranked[rank + 1 :], bounds[rank + 1 :])
            claimed[taken if left is None else taken & ~left] = rank
    row_of_rank = np.array([pixels.silhouette.row for pixels in ranked], np.int64)
    is_explained = explained_by != NOT_MEASURED
    explained_by[is_explained] = row_of_rank[explained_by[is_explained]]
    return owned, explained_by


_ISLAND: Final = 0.5
"""Largest area of an island, as a share of the box's largest patch."""

_NOTABLE: Final = 0.02
"""Least area of an island, as a share of the farther box's silhouette."""


_LEFT, _TOP, _WIDTH, _HEIGHT, _AREA = (
    cv2.CC_STAT_LEFT,
    cv2.CC_STAT_TOP,
    cv2.CC_STAT_WIDTH,
    cv2.CC_STAT_HEIGHT,
    cv2.CC_STAT_AREA,
)


def silhouette_bounds(boxes: Sequence[AcceptedPixels]) -> IntArray:
    """(N, 4) int64, px: first column and row, last column and row + 1, of N boxes."""
    corners = [
        (outline.x0, outline.y0, outline.x1, outline.y1)
        for outline in (box.silhouette for box in boxes)
    ]
    return np.array(corners, np.int64).reshape(-1, 4)


def islands(
    box: AcceptedPixels, behind: Sequence[AcceptedPixels], bounds: IntArray
) -> Mask | None:
    """(h, w) bool: the pixels of a box's region that more likely are of boxes behind.

    None if there are none.

    Parameters
    ----------
    behind : the boxes that are farther away
    bounds : (len(behind), 4) int64, as `silhouette_bounds` gives them

    Notes
    -----
    Most objects are seen as one connected patch. Another patch in the box's region is
    an island if

    * it is at most half as large as the largest one (`_ISLAND`),
    * it does not touch the border of the region,
    * it lies completely in the accepted pixels of a farther box, and
    * it fills at least 2 % of that box's silhouette (`_NOTABLE`).

    What is seen over the bonnet of a car, or under the arm of a traffic light, is such
    a patch. The halves of a car behind a tree are not (too large), nor are the
    splinters of one behind a fence (too small).
    """
    around = box.mask if box.around is None else box.around
    if len(behind) == 0 or min(around.shape) <= 2 or not box.count:
        return None
    components = cv2.connectedComponentsWithStats(around.view(np.uint8), connectivity=8)
    labels: IntArray = components[1].astype(np.int64)
    stats: IntArray = components[2].astype(np.int64)
    # Which patches are small compared with the largest and do not touch the border
    area = stats[:, _AREA]
    own = np.bincount(labels[box.own], minlength=len(stats))
    largest = int(own.argmax())
    height, width = labels.shape
    small = (
        (area <= _ISLAND * own[largest]) & (stats[:, _LEFT] > 0) & (stats[:, _TOP] > 0)
    )
    small &= stats[:, _LEFT] + stats[:, _WIDTH] < width
    small &= stats[:, _TOP] + stats[:, _HEIGHT] < height
    # Label 0 is everything that is not accepted.
    small[[0, largest]] = False
    if not small.any():
        return None
    x0, y0 = box.silhouette.x0, box.silhouette.y0
    left, top = stats[:, _LEFT] + x0, stats[:, _TOP] + y0
    right, bottom = left + stats[:, _WIDTH], top + stats[:, _HEIGHT]
    fits = small & (bounds[:, :1] <= left) & (bounds[:, 1:2] <= top)
    fits &= (bounds[:, 2:3] >= right) & (bounds[:, 3:4] >= bottom)
    is_island = np.zeros(len(stats), np.bool_)
    for place in np.flatnonzero(fits.any(axis=1)).tolist():
        candidates = fits[place] & ~is_island
        if candidates.any():
            is_island |= candidates & _held(box, labels, stats, behind[place])
    return is_island[labels] if is_island.any() else None


def _held(
    box: AcceptedPixels, labels: IntArray, stats: IntArray, other: AcceptedPixels
) -> BoolArray:
    """Which patches lie completely in the other box and fill enough of it."""
    mine, theirs = box.silhouette, other.silhouette
    x0, y0 = max(mine.x0, theirs.x0), max(mine.y0, theirs.y0)
    x1, y1 = min(mine.x1, theirs.x1), min(mine.y1, theirs.y1)
    part = labels[y0 - mine.y0 : y1 - mine.y0, x0 - mine.x0 : x1 - mine.x0]
    mask = other.mask[y0 - theirs.y0 : y1 - theirs.y0, x0 - theirs.x0 : x1 - theirs.x0]
    counted = np.bincount(part[mask], minlength=len(stats))
    area = stats[:, _AREA]
    return np.asarray((counted == area) & (area >= _NOTABLE * theirs.pixels))
