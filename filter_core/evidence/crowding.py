"""Crowding: how much of a box another box of a similar class covers. Reads no pixels.

A semantic segmentation cannot tell two cars apart: where two boxes overlap, matching
pixels of one may belong to the other. Crowding is the largest share of a box that one
other box could have contributed. Such other boxes are called rivals here.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from filter_core.arrays import BoxesXYXY, FloatArray, IntArray

_MOST_PAIRS: Final = 1 << 16
"""Up to this many pairs, comparing all of them at once is the fastest."""

_LARGEST: Final = 96
"""How many of the largest rivals are first compared with every box."""

_AT_ONCE: Final = 8
"""How many of them at a time; boxes that are wholly covered then drop out."""

_WORTHWHILE: Final = 0.98
"""If a larger share of boxes does not drop out, no more large rivals are tried."""

_GROUP: Final = 32
"""How many neighbouring boxes share one selection of rivals."""

_CHUNK: Final = 1 << 15
"""Pairs at a time: temporary arrays stay in the processor's cache."""


def crowding_percent(
    xyxy: BoxesXYXY, accept_mask: IntArray, *, most_pairs: int = _MOST_PAIRS
) -> FloatArray:
    """(N,) float64, percent: the largest share of each box that another covers.

    The other is of an alike class; 0 where no box that is alike overlaps.

    Parameters
    ----------
    xyxy : (N, 4) float64, px
        Corrected boxes. NaN rows cover nothing and are covered by nothing.
    accept_mask : (N,) int64
        Boxes whose masks share a bit are alike.
    most_pairs : int
        Up to this many pairs, all are compared at once. It changes the time that this
        takes, never the result.

    Notes
    -----
    Exact: equal to comparing all pairs. Many boxes are grouped by size and place, and
    a rival is only compared with a group if it could cover more of one of its boxes
    than the best rival so far. The largest rivals and the group itself are compared
    first, since they mostly cover much and so rule out most others.
    """
    percent = np.zeros(len(xyxy))
    live = np.flatnonzero(~np.isnan(xyxy).any(axis=1) & (accept_mask != 0))
    if len(live) < 2:
        return percent
    boxes, masks = xyxy[live], accept_mask[live]
    if len(live) ** 2 <= most_pairs:
        alike = masks[:, None] & masks[None, :] != 0
        np.fill_diagonal(alike, False)
        common = _common_areas(boxes.T, boxes.T)
        common[~alike] = 0.0
        covered: FloatArray = common.max(axis=1)
    else:
        covered = np.zeros(len(boxes))
        for mask in np.unique(masks):
            own = np.flatnonzero(masks == mask)
            search = _Search(boxes, np.flatnonzero(masks & mask))
            covered[own] = search.covered_areas(own)
    extent = boxes[:, 2:] - boxes[:, :2]
    area = extent[:, 0] * extent[:, 1]
    # The area of a sliver can underflow to 0, and then so does the covered area. The
    # division comes first, so that the share of a wholly covered box is exactly 1.
    percent[live] = 100.0 * (covered / np.where(area > 0, area, 1.0))
    return percent


def most_covering(xyxy: BoxesXYXY, accept_mask: IntArray, row: int) -> int:
    """The row of the box that covers most of one box, as `crowding_percent` says.

    Raises `ValueError`: no other box that is alike overlaps it.
    """
    common = np.nan_to_num(_common_areas(xyxy[row : row + 1].T, xyxy.T)[0])
    common[(accept_mask & accept_mask[row]) == 0] = 0.0
    common[row] = 0.0
    if not common.any():
        raise ValueError(f"expected a box that overlaps box {row}, found none")
    return int(common.argmax())


def _common_areas(some: FloatArray, others: FloatArray) -> FloatArray:
    """(M, K): the areas of the intersections of (4, M) with (4, K) boxes."""
    x0, y0, x1, y1 = some[:, :, None]
    width = np.minimum(x1, others[2])
    width -= np.maximum(x0, others[0])
    height = np.minimum(y1, others[3])
    height -= np.maximum(y0, others[1])
    np.maximum(width, 0.0, out=width)
    np.maximum(height, 0.0, out=height)
    common: FloatArray = width * height
    return common


class _Search:
    """Finds, for boxes of one accept mask, the rival that covers most of each."""

    def __init__(self, boxes: BoxesXYXY, rivals: IntArray) -> None:
        self.boxes = np.ascontiguousarray(boxes.T)
        extent = self.boxes[2:] - self.boxes[:2]
        self.areas: FloatArray = extent[0] * extent[1]
        self.order = rivals[np.argsort(-self.areas[rivals], kind="stable")]
        self.rivals = self.boxes[:, self.order]
        self.place = np.full(boxes.shape[0], -1)
        self.place[self.order] = np.arange(len(rivals))

    def covered_areas(self, own: IntArray) -> FloatArray:
        """(M,) float64: the largest area that one rival covers of each box, px."""
        best = np.zeros(len(own))
        open_ = np.arange(len(own))
        for start in range(0, min(_LARGEST, len(self.order)), _AT_ONCE):
            rivals = np.arange(start, min(start + _AT_ONCE, len(self.order)))
            best[open_] = np.maximum(best[open_], self._cover(own[open_], rivals))
            # Nothing covers more of a box than all of it.
            still_open = open_[best[open_] < self.areas[own[open_]]]
            few_closed = len(still_open) > _WORTHWHILE * len(open_)
            open_ = still_open
            if few_closed:
                break
        # In an order in which neighbours are alike in place and size: width and height
        # differ by less than a factor of four
        boxes = self.boxes[:, own[open_]]
        extent = boxes[2:] - boxes[:2]
        if not extent.size:
            return best
        size_class = np.floor(np.log2(extent) / 2).astype(np.int64)
        centre = (boxes[:2] + boxes[2:]) / 2
        low, high = centre.min(axis=1), centre.max(axis=1)
        cells = 255.0 / np.maximum(high - low, 1.0)
        column, row = ((centre - low[:, None]) * cells[:, None]).astype(np.int64)
        place = _spread_bits(column) | _spread_bits(row) << 1
        near = open_[np.lexsort((place, size_class[1], size_class[0]))]
        for start in range(0, len(near), _GROUP):
            group = near[start : start + _GROUP]
            best[group] = self._cover_group(own[group], best[group])
        return best

    def _cover_group(self, own: IntArray, best: FloatArray) -> FloatArray:
        best = np.maximum(best, self._cover(own, np.sort(self.place[own])))
        # Places of the rivals that could cover more than `best` of a box of `own`
        x0, y0, x1, y1 = self.boxes[:, own]
        share = best / self.areas[own] * (1.0 - 1e-9) - 1e-9
        across, down = share * (x1 - x0), share * (y1 - y0)
        smallest = best.min() * (1.0 - 1e-9)
        count = np.searchsorted(-self.areas[self.order], -smallest, side="right")
        rivals = self.rivals[:, :count]
        keep = rivals[0] <= (x1 - across).max()
        keep &= rivals[1] <= (y1 - down).max()
        keep &= rivals[2] >= (x0 + across).min()
        keep &= rivals[3] >= (y0 + down).min()
        promising = np.flatnonzero(keep)
        step = _CHUNK // _GROUP
        for start in range(0, len(promising), step):
            part = promising[start : start + step]
            best = np.maximum(best, self._cover(own, part))
        return best

    def _cover(self, own: IntArray, rivals: IntArray) -> FloatArray:
        """(M,): the largest area that one of some rivals covers of each box.

        `rivals` are places in `self.order`, ascending; a box is no rival of itself.
        """
        # numpy is fastest along the last axis, so the longer one comes last.
        upright = len(own) > len(rivals)
        boxes, others = self.boxes[:, own], self.rivals[:, rivals]
        common = (
            _common_areas(others, boxes).T if upright else _common_areas(boxes, others)
        )
        place = self.place[own]
        column = np.searchsorted(rivals, place)
        column[column == len(rivals)] = 0
        itself = np.flatnonzero(rivals[column] == place)
        common[itself, column[itself]] = 0.0
        covered: FloatArray = common.max(axis=1)
        return covered


def _spread_bits(values: IntArray) -> IntArray:
    """Insert a 0 before each of eight bits; two such numbers form a Morton code."""
    values = (values | values << 4) & 0x0F0F
    values = (values | values << 2) & 0x3333
    return (values | values << 1) & 0x5555
