"""Verdicts from evidence and a configuration: `decide`. Reads no pixel.

The rules of the paper's Algorithm 2 are a table here. Rules of other evidence than the
segmentation are in `channel_rules`, which `decide` applies afterwards.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from filter_core.config.filter import DecideConfig, LimitsByClass
from filter_core.decisions.channel_rules import apply_channels
from filter_core.types import (
    BoolArray,
    BoxState,
    Decisions,
    Evidence,
    FloatArray,
    IntArray,
    Reason,
)

Z95: Final = 1.959963984540054
"""95 % of a normal distribution lie within as many standard deviations of its mean."""

_BLOCK: Final = 1 << 15
"""Boxes per block: temporary arrays of 256 KiB stay in the processor's cache."""

_PerBox: TypeAlias = FloatArray | IntArray | np.float64 | np.int64
"""An array with one number per box, or one number if all classes share it."""


class _Bit(IntEnum):
    """The conditions of the rules, as bits; the lowest two hold the `BoxState`."""

    OUT_OF_RANGE = 1 << 2
    UNMAPPED = 1 << 3
    UNMEASURED = 1 << 4
    TOO_FEW_PIXELS = 1 << 5
    FAILS_LARGE_THRESHOLD = 1 << 6
    FAILS_SMALL_THRESHOLD = 1 << 7


_STATE_BITS: Final = 0b11

_RULES: Final = (
    (Reason.OUTSIDE_IMAGE, _STATE_BITS, BoxState.OUTSIDE_IMAGE),
    (Reason.COVERS_IMAGE, _STATE_BITS, BoxState.COVERS_IMAGE),
    (Reason.DEGENERATE, _STATE_BITS, BoxState.DEGENERATE),
    (Reason.OUT_OF_RANGE, _Bit.OUT_OF_RANGE, _Bit.OUT_OF_RANGE),
    (Reason.UNMAPPED_CLASS, _Bit.UNMAPPED, _Bit.UNMAPPED),
    (Reason.NO_SEGMENTATION, _Bit.UNMEASURED, _Bit.UNMEASURED),
    (Reason.NO_VISIBLE_PIXELS, _Bit.TOO_FEW_PIXELS, _Bit.TOO_FEW_PIXELS),
    (
        Reason.LARGE_BELOW_THRESHOLD,
        _Bit.FAILS_LARGE_THRESHOLD,
        _Bit.FAILS_LARGE_THRESHOLD,
    ),
    (Reason.BELOW_THRESHOLD, _Bit.FAILS_SMALL_THRESHOLD, _Bit.FAILS_SMALL_THRESHOLD),
    (Reason.VISIBLE, 0, 0),
)
"""Reason, mask, value, in the order of Algorithm 2.

The first row with ``bits & mask == value`` decides. Lists repeat in SQL how thresholds
decide, to find the boxes around a threshold: `ClassThresholds.sides` and
`THRESHOLD_REASONS` in `app/boxes/filter.py`, which
`tests/unit/app/boxes/test_thresholds_in_sql.py` compares. Labels on the page repeat
only whether a match has to reach or to exceed its threshold
(`static/js/boxes/wording.js`).
"""

_REASON_OF_BITS: Final = np.array(
    [
        next(reason for reason, mask, value in _RULES if bits & mask == value)
        for bits in range(256)
    ],
    dtype=np.uint8,
)
"""The deciding rule of each of the 256 combinations of bits.

Looking a box up here is faster than applying one mask per rule.
"""

_IF_LARGE: Final = 1 + max(Reason)
"""The first row for large boxes in `_COLUMN_OF_REASON`; those of others are before."""

_THRESHOLD_COLUMNS: Final = 4

_SMALL_BOX, _LARGE_BOX, _KEPT_LARGE_BOX, _NO_THRESHOLD = range(_THRESHOLD_COLUMNS)
"""Which threshold applied to a box: the columns of the table in `_Block._threshold`.

The first three are `LimitsByClass.threshold_small_box`, `threshold_big_box` and
`threshold_kept_large_box`.
"""


def _columns_of_reasons() -> NDArray[np.uint8]:
    columns = np.full(2 * _IF_LARGE, _NO_THRESHOLD, dtype=np.uint8)
    columns[Reason.BELOW_THRESHOLD] = _SMALL_BOX
    columns[_IF_LARGE + Reason.BELOW_THRESHOLD] = _SMALL_BOX
    columns[_IF_LARGE + Reason.LARGE_BELOW_THRESHOLD] = _LARGE_BOX
    columns[Reason.VISIBLE] = _SMALL_BOX
    columns[_IF_LARGE + Reason.VISIBLE] = _KEPT_LARGE_BOX
    return columns


_COLUMN_OF_REASON: Final = _columns_of_reasons()
"""(2 * _IF_LARGE,) uint8: which threshold applied to a box.

The index is the number of the box's reason, plus `_IF_LARGE` if the box is large.
"""


def decide(evidence: Evidence, config: DecideConfig) -> Decisions:
    """Decide each box by the first rule that matches it.

    Parameters
    ----------
    evidence : Evidence of N boxes
        As measured with the profile of `config` and with its accept sets (see
        `MeasureConfig.accept_masks`); `xyxy` and `tag_counts` are not read.
    config : DecideConfig

    Returns
    -------
    Decisions of N boxes
        `threshold` and `margin` are NaN and `toss_up` is False where no threshold
        decided.

    Notes
    -----
    O(N), without a loop over boxes. The 95 % Wilson interval of a share p of n pixels
    contains a threshold t exactly if ``(p - t)^2 <= z^2 t (1 - t) / n`` [2]_, since the
    Wilson interval is the inverted score test; so the interval is never computed.

    References
    ----------
    .. [1] M. Chaar, J. Raiyn, G. Weidl, "Improve Bounding Box in Carla Simulator",
       VEHITS 2024, Algorithm 2.
    .. [2] E. B. Wilson, "Probable inference, the law of succession, and statistical
       inference", JASA 22, 1927.
    """
    count = len(evidence)
    decisions = Decisions(
        reason=np.empty(count, np.uint8),
        threshold=np.empty(count, np.float64),
        margin=np.empty(count, np.float64),
        toss_up=np.empty(count, np.bool_),
        large=np.empty(count, np.bool_),
    )
    thresholds = config.thresholds_for(evidence.class_names)
    as_carlasimu = config.profile == "carlasimu"
    for start in range(0, count, _BLOCK):
        rows = slice(start, start + _BLOCK)
        _Block(evidence, thresholds, rows, as_carlasimu).write(decisions)
    apply_channels(evidence, config, decisions)
    return decisions


def pixels_needed(evidence: Evidence, config: DecideConfig) -> IntArray:
    """(N,) int64: the fewest pixels with an accepted tag that keep each of N boxes."""
    thresholds = config.thresholds_for(evidence.class_names)
    needed = np.empty(len(evidence), np.int64)
    needed[:] = _pixels_needed(thresholds, evidence.class_index)
    return needed


def _pixels_needed(
    thresholds: LimitsByClass, class_index: NDArray[np.int32]
) -> _PerBox:
    return _per_box(thresholds.min_visible_pixels, class_index)


class _Block:
    """A block of boxes, the range `rows` of the evidence, to be decided.

    `as_carlasimu`: as under profile ``carlasimu``, which differs from ``paper`` in
    three ways: a box of exactly the size `size_big_box` is large; a match equal to a
    threshold fails; and large boxes must pass both thresholds.
    """

    def __init__(
        self,
        evidence: Evidence,
        thresholds: LimitsByClass,
        rows: slice,
        as_carlasimu: bool,
    ) -> None:
        self.evidence, self.thresholds = evidence, thresholds
        self.rows, self.as_carlasimu = rows, as_carlasimu
        self.class_index = evidence.class_index[rows]
        self.match = evidence.match_percent[rows]

    def write(self, decisions: Decisions) -> None:
        """Decide the block and write the results into its rows of `decisions`."""
        rows = self.rows
        large = self._is_large()
        reason = _REASON_OF_BITS.take(self._bits(large))
        column = _COLUMN_OF_REASON.take(reason + large * np.uint8(_IF_LARGE))
        threshold = self._threshold(column)
        # Under carlasimu the match can exceed 100.
        margin = np.minimum(self.match, 100.0) - threshold
        decisions.reason[rows] = reason
        decisions.threshold[rows] = threshold
        decisions.margin[rows] = margin
        decisions.toss_up[rows] = self._is_toss_up(threshold, margin)
        decisions.large[rows] = large & (column != _NO_THRESHOLD)

    def _bits(self, large: BoolArray) -> NDArray[np.uint8]:
        evidence, thresholds, rows = self.evidence, self.thresholds, self.rows
        fails_small_threshold = self._fails(thresholds.threshold_small_box)
        # In carlasimu large boxes must pass the threshold for small ones too.
        if not self.as_carlasimu:
            fails_small_threshold &= ~large
        fails_large_threshold = self._fails(thresholds.threshold_big_box) & large
        bits: NDArray[np.uint8] = evidence.state[rows].copy()
        for holds, bit in (
            (self._is_out_of_range(), _Bit.OUT_OF_RANGE),
            (evidence.accept_mask[rows] == 0, _Bit.UNMAPPED),
            (~evidence.measured[rows], _Bit.UNMEASURED),
            (self._has_too_few_pixels(), _Bit.TOO_FEW_PIXELS),
            (fails_large_threshold, _Bit.FAILS_LARGE_THRESHOLD),
            (fails_small_threshold, _Bit.FAILS_SMALL_THRESHOLD),
        ):
            bits |= holds.view(np.uint8) * np.uint8(bit)
        return bits

    def _threshold(self, column: NDArray[np.uint8]) -> FloatArray:
        """Each box's threshold: from the row of its class and the given column."""
        thresholds = self.thresholds
        small, large = thresholds.threshold_small_box, thresholds.threshold_big_box
        kept_large = thresholds.threshold_kept_large_box
        none = np.full(len(small), np.nan)
        table = np.column_stack([small, large, kept_large, none])
        threshold: FloatArray = table.take(
            self.class_index * _THRESHOLD_COLUMNS + column
        )
        return threshold

    def _has_too_few_pixels(self) -> BoolArray:
        needed = _pixels_needed(self.thresholds, self.class_index)
        too_few: BoolArray = self.evidence.matched_pixels[self.rows] < needed
        return too_few

    def _is_out_of_range(self) -> BoolArray:
        nearest, farthest = self.thresholds.min_distance, self.thresholds.max_distance
        distance = self.evidence.distance[self.rows]
        if np.isinf(nearest).all() and np.isinf(farthest).all():
            return np.zeros(len(distance), np.bool_)
        # An unknown distance (NaN) is never out of range.
        out_of_range = distance < self._for_boxes(nearest)
        out_of_range |= distance > self._for_boxes(farthest)
        return out_of_range

    def _is_large(self) -> BoolArray:
        area = self.evidence.area_percent[self.rows]
        size = self._for_boxes(self.thresholds.size_big_box)
        return area >= size if self.as_carlasimu else area > size

    def _fails(self, per_class: FloatArray) -> BoolArray:
        """Whether each box's match is too low for the threshold of its class."""
        threshold = self._for_boxes(per_class)
        if self.as_carlasimu:
            return self.match <= threshold
        return self.match < threshold

    def _is_toss_up(self, threshold: FloatArray, margin: FloatArray) -> BoolArray:
        spread = threshold * (100.0 - threshold)
        spread *= Z95 * Z95
        deviation = margin * margin
        deviation *= self.evidence.box_pixels[self.rows]
        # False where there is no threshold: NaN compares as False.
        toss_up: BoolArray = deviation <= spread
        return toss_up

    def _for_boxes(self, per_class: FloatArray | IntArray) -> _PerBox:
        return _per_box(per_class, self.class_index)


def _per_box(
    per_class: FloatArray | IntArray, class_index: NDArray[np.int32]
) -> _PerBox:
    """The number of each box, from a (K,) array of numbers by class."""
    alike = bool((per_class == per_class[0]).all())
    chosen: _PerBox = per_class[0] if alike else per_class.take(class_index)
    return chosen
