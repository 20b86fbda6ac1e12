"""Evidence and a configuration in, verdicts out. Reads no pixel."""

from __future__ import annotations

from enum import IntEnum
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from filter_core.config.filter import DecideConfig, Thresholds
from filter_core.decisions.channels import apply_channels
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
"""Two-sided 95 % quantile of the normal distribution."""

_BLOCK: Final = 1 << 15
"""Boxes decided at a time: temporaries of 256 KiB stay in the processor's cache."""

_Limit: TypeAlias = FloatArray | IntArray | np.float64 | np.int64
"""One number per box, or one for all."""


class _Bit(IntEnum):
    """What is true of a box; its state (`BoxState`) is in the two lowest bits."""

    OUT_OF_RANGE = 1 << 2
    UNMAPPED = 1 << 3
    UNMEASURED = 1 << 4
    TOO_FEW_PIXELS = 1 << 5
    FAILS_BIG = 1 << 6
    FAILS_SMALL = 1 << 7


_STATE_BITS: Final = 0b11

_RULES: Final = (
    (Reason.OUTSIDE_IMAGE, _STATE_BITS, BoxState.OUTSIDE_IMAGE),
    (Reason.COVERS_IMAGE, _STATE_BITS, BoxState.COVERS_IMAGE),
    (Reason.DEGENERATE, _STATE_BITS, BoxState.DEGENERATE),
    (Reason.OUT_OF_RANGE, _Bit.OUT_OF_RANGE, _Bit.OUT_OF_RANGE),
    (Reason.UNMAPPED_CLASS, _Bit.UNMAPPED, _Bit.UNMAPPED),
    (Reason.NO_SEGMENTATION, _Bit.UNMEASURED, _Bit.UNMEASURED),
    (Reason.NO_VISIBLE_PIXELS, _Bit.TOO_FEW_PIXELS, _Bit.TOO_FEW_PIXELS),
    (Reason.LARGE_BELOW_THRESHOLD, _Bit.FAILS_BIG, _Bit.FAILS_BIG),
    (Reason.BELOW_THRESHOLD, _Bit.FAILS_SMALL, _Bit.FAILS_SMALL),
    (Reason.VISIBLE, 0, 0),
)
"""Algorithm 2 in its order: the first row whose bits under the mask are these."""

_REASON_OF_BITS: Final = np.array(
    [
        next(reason for reason, mask, value in _RULES if bits & mask == value)
        for bits in range(256)
    ],
    dtype=np.uint8,
)
"""The rules, applied once to every combination: masks per rule cost 4 ms per million
boxes and rule, one look-up 0.7 ms for all of them."""

# Columns of the table of thresholds that can have applied to a class.
_SMALL, _BIG, _KEPT_LARGE, _NONE = range(4)

_COLUMN_OF_REASON: Final = np.full(2 * 16, _NONE, dtype=np.uint8)

_COLUMN_OF_REASON[[Reason.BELOW_THRESHOLD, 16 + Reason.BELOW_THRESHOLD]] = _SMALL

_COLUMN_OF_REASON[16 + Reason.LARGE_BELOW_THRESHOLD] = _BIG

_COLUMN_OF_REASON[[Reason.VISIBLE, 16 + Reason.VISIBLE]] = _SMALL, _KEPT_LARGE
"""By reason, plus 16 if the box is large."""


def decide(evidence: Evidence, config: DecideConfig) -> Decisions:
    """The first rule that matches each box, and the numbers that it rests on.

    Parameters
    ----------
    evidence : Evidence of N boxes
        As measured with the profile of `config` and with its accept sets (see
        `MeasureConfig.accept_masks`); `xyxy` and `tag_counts` are not looked at.
    config : DecideConfig

    Returns
    -------
    Decisions of N boxes
        `threshold`, `margin` and `toss_up` are NaN, NaN and False where a rule before
        the thresholds decided.

    Notes
    -----
    O(N), without a loop over boxes. The 95 % Wilson interval of a share p of n pixels
    contains a threshold t exactly if ``(p - t)^2 <= z^2 t (1 - t) / n`` [2]_, since it
    is the score test turned round; so the interval itself is never computed.

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
    limits = config.thresholds_for(evidence.class_names)
    published = config.profile == "carlasimu"
    for start in range(0, count, _BLOCK):
        part = slice(start, start + _BLOCK)
        _Block(evidence, limits, part, published).write(decisions)
    apply_channels(evidence, config, decisions)
    return decisions


class _Block:
    """The rules over one run of boxes; `published` is profile ``carlasimu``."""

    def __init__(
        self, evidence: Evidence, limits: Thresholds, part: slice, published: bool
    ) -> None:
        self.evidence, self.limits = evidence, limits
        self.part, self.published = part, published
        self.class_index = evidence.class_index[part]
        self.match = evidence.match_percent[part]

    def write(self, decisions: Decisions) -> None:
        """Decide these boxes into their places."""
        part = self.part
        large = self._is_large()
        reason = _REASON_OF_BITS.take(self._bits(large))
        column = _COLUMN_OF_REASON.take(reason | large.view(np.uint8) << 4)
        threshold = self._threshold(column)
        # The published code's float area can give more than all of a box's pixels.
        margin = np.minimum(self.match, 100.0) - threshold
        decisions.reason[part] = reason
        decisions.threshold[part] = threshold
        decisions.margin[part] = margin
        decisions.toss_up[part] = self._is_toss_up(threshold, margin)
        decisions.large[part] = large & (column != _NONE)

    def _bits(self, large: BoolArray) -> NDArray[np.uint8]:
        evidence, limits, part = self.evidence, self.limits, self.part
        fails_small = self._fails(limits.threshold_small_box)
        if not self.published:  # whose code tests large boxes by this one as well
            fails_small &= ~large
        bits: NDArray[np.uint8] = evidence.state[part].copy()
        for holds, bit in (
            (self._is_out_of_range(), _Bit.OUT_OF_RANGE),
            (evidence.accept_mask[part] == 0, _Bit.UNMAPPED),
            (~evidence.measured[part], _Bit.UNMEASURED),
            (self._has_too_few_pixels(), _Bit.TOO_FEW_PIXELS),
            (self._fails(limits.threshold_big_box) & large, _Bit.FAILS_BIG),
            (fails_small, _Bit.FAILS_SMALL),
        ):
            bits |= holds.view(np.uint8) * np.uint8(bit)
        return bits

    def _threshold(self, column: NDArray[np.uint8]) -> FloatArray:
        """The threshold in each box's class and column."""
        small, big = self.limits.threshold_small_box, self.limits.threshold_big_box
        kept_large = np.maximum(small, big) if self.published else big
        table = np.column_stack([small, big, kept_large, np.full(len(small), np.nan)])
        threshold: FloatArray = table.take(self.class_index * 4 + column)
        return threshold

    def _has_too_few_pixels(self) -> BoolArray:
        needed = self._limit(self.limits.min_visible_pixels)
        too_few: BoolArray = self.evidence.matched_pixels[self.part] < needed
        return too_few

    def _is_out_of_range(self) -> BoolArray:
        limits = self.limits
        distance = self.evidence.distance[self.part]  # NaN is neither near nor far
        if np.isinf(limits.min_distance).all() and np.isinf(limits.max_distance).all():
            return np.zeros(len(distance), np.bool_)
        too_near = distance < self._limit(limits.min_distance)
        too_near |= distance > self._limit(limits.max_distance)
        return too_near

    def _is_large(self) -> BoolArray:
        area = self.evidence.area_percent[self.part]
        size = self._limit(self.limits.size_big_box)
        return area >= size if self.published else area > size

    def _fails(self, per_class: FloatArray) -> BoolArray:
        threshold = self._limit(per_class)
        if self.published:
            return self.match <= threshold
        return self.match < threshold

    def _is_toss_up(self, threshold: FloatArray, margin: FloatArray) -> BoolArray:
        spread = threshold * (100.0 - threshold)
        spread *= Z95 * Z95
        deviation = margin * margin
        deviation *= self.evidence.box_pixels[self.part]
        toss_up: BoolArray = deviation <= spread  # NaN, no threshold: False
        return toss_up

    def _limit(self, per_class: FloatArray | IntArray) -> _Limit:
        alike = bool((per_class == per_class[0]).all())
        chosen: _Limit = per_class[0] if alike else per_class.take(self.class_index)
        return chosen
