"""Evidence and a configuration in, verdicts out. Reads no pixel."""

from __future__ import annotations

from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from filter_core.config import FilterConfig, Thresholds
from filter_core.types import (
    BoolArray,
    BoxState,
    Decisions,
    Evidence,
    FloatArray,
    IntArray,
    Reason,
)

_Z95: Final = 1.959963984540054
"""Two-sided 95 % quantile of the normal distribution."""
_BLOCK: Final = 1 << 15
"""Boxes decided at a time: temporaries of 256 KiB stay in the processor's cache."""

_Limit: TypeAlias = FloatArray | IntArray | np.float64 | np.int64
"""One number per box, or one for all."""


def decide(evidence: Evidence, config: FilterConfig) -> Decisions:
    """The first rule that matches each box, and the numbers that it rests on.

    Parameters
    ----------
    evidence : Evidence of N boxes
        As measured with the profile of `config` and with its accept sets (see
        `FilterConfig.accept_masks`); `xyxy` and `tag_counts` are not looked at.
    config : FilterConfig

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
        limits, part = self.limits, self.part
        big = self._limit(limits.threshold_big_box)
        small = self._limit(limits.threshold_small_box)
        large = self._is_large()
        fails_big, fails_small = self._fails(big) & large, self._fails(small)
        if self.published:
            # Its code tests large boxes against the small threshold as well.
            threshold = np.where(large & (fails_big | (big >= small)), big, small)
        else:
            threshold = np.where(large, big, small)
            fails_small &= ~large

        reason = self._reason(fails_big, fails_small)
        judged = (reason == Reason.VISIBLE) | (reason == Reason.BELOW_THRESHOLD)
        judged |= reason == Reason.LARGE_BELOW_THRESHOLD
        np.copyto(threshold, np.nan, where=~judged)
        # The published code's float area can give more than all of a box's pixels.
        margin = np.minimum(self.match, 100.0) - threshold
        decisions.reason[part] = reason
        decisions.threshold[part] = threshold
        decisions.margin[part] = margin
        decisions.toss_up[part] = self._is_toss_up(threshold, margin)
        decisions.large[part] = large & judged

    def _reason(
        self, fails_big: BoolArray, fails_small: BoolArray
    ) -> NDArray[np.uint8]:
        """The rules in their order, written from the last to the first."""
        evidence, part = self.evidence, self.part
        state = evidence.state[part]
        too_few = evidence.matched_pixels[part] < self._limit(
            self.limits.min_visible_pixels
        )
        reason = np.full(len(self.class_index), Reason.VISIBLE, np.uint8)
        for matches, name in (
            (fails_small, Reason.BELOW_THRESHOLD),
            (fails_big, Reason.LARGE_BELOW_THRESHOLD),
            (too_few, Reason.NO_VISIBLE_PIXELS),
            (~evidence.measured[part], Reason.NO_SEGMENTATION),
            (evidence.accept_mask[part] == 0, Reason.UNMAPPED_CLASS),
            (self._is_out_of_range(), Reason.OUT_OF_RANGE),
            (state == BoxState.DEGENERATE, Reason.DEGENERATE),
            (state == BoxState.COVERS_IMAGE, Reason.COVERS_IMAGE),
            (state == BoxState.OUTSIDE_IMAGE, Reason.OUTSIDE_IMAGE),
        ):
            # Several times faster than reason[matches] = name.
            np.copyto(reason, np.uint8(name), where=matches)
        return reason

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

    def _fails(self, threshold: _Limit) -> BoolArray:
        if self.published:
            return self.match <= threshold
        return self.match < threshold

    def _is_toss_up(self, threshold: FloatArray, margin: FloatArray) -> BoolArray:
        spread = threshold * (100.0 - threshold)
        spread *= _Z95 * _Z95
        deviation = margin * margin
        deviation *= self.evidence.box_pixels[self.part]
        toss_up: BoolArray = deviation <= spread  # NaN, no threshold: False
        return toss_up

    def _limit(self, per_class: FloatArray | IntArray) -> _Limit:
        alike = bool((per_class == per_class[0]).all())
        chosen: _Limit = per_class[0] if alike else per_class[self.class_index]
        return chosen
