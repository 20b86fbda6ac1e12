"""Verdicts from evidence and a configuration: `decide`. Reads no pixel.

The rules are Algorithm 2 of the paper that the filter implements: M. Chaar, J. Raiyn,
G. Weidl, "Improve Bounding Box in Carla Simulator", VEHITS 2024. `_rules` lists them in
their order: for each reason, its condition. Rules of other evidence than the
segmentation are in `channel_rules`, which `decide` applies afterwards.

A new threshold is a key in `filter_core/config/keys.py`, a comparison in `_rules` (or
in `channel_rules`), and its sentence in `explain`. "Add a key of a configuration" in
ARCHITECTURE.md has the whole list, and what else is needed if the threshold is compared
with the match; "Add a rule or a reason" has it for a new reason.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import BoolArray, FloatArray, IntArray
from filter_core.config.filter import DecideConfig, LimitsByClass
from filter_core.decisions.channel_rules import (
    IS_FINAL,
    apply_channels,
    with_more_pixels,
)
from filter_core.evidence_numbers import BoxState, Evidence
from filter_core.verdicts import REJECTED, VERDICT_OF_REASON, Decisions, Reason

Z95: Final = 1.959963984540054
"""95 % of a normal distribution lie within so many standard deviations of its mean."""

_BLOCK: Final = 1 << 15
"""Boxes per block: temporary arrays of 256 KiB stay in the processor's cache."""

_PerBox: TypeAlias = FloatArray | IntArray | np.float64 | np.int64
"""An array with one number per box, or one number if all classes share it."""

_Rule: TypeAlias = tuple[Reason, BoolArray]
"""A reason, and (N,) bool: for which boxes its condition holds."""


def decide(evidence: Evidence, config: DecideConfig) -> Decisions:
    """Decide each of N boxes: by the first rule whose condition holds, or by a channel.

    `evidence` is measured with the profile of `config` and with the tags that it
    accepts for each class (`MeasureConfig.accept_masks`); `xyxy` and `tag_counts` are
    not read. Where a channel of the configuration has a number for a box, its rule
    replaces the decision, unless the reason of that decision is final
    (`Reason.is_final`): no measurement changes, for instance, that a box is outside the
    image. `threshold` and `margin` are NaN and `toss_up` is False where no threshold
    decided.

    Notes
    -----
    O(N), without a loop over boxes. A box is a toss-up if the 95 % Wilson interval [1]_
    of its match contains the threshold.

    References
    ----------
    .. [1] E. B. Wilson, "Probable inference, the law of succession, and statistical
       inference", JASA 22, 1927.
    """
    count = len(evidence)
    decisions = Decisions(
        reason=np.empty(count, np.uint8),
        threshold=np.empty(count, np.float64),
        margin=np.empty(count, np.float64),
        toss_up=np.empty(count, np.bool_),
        large=np.empty(count, np.bool_),
        channel=np.zeros(count, np.uint8),
    )
    limits = config.limits_by_class(evidence.class_names)
    # (2, K, 1 + max(Reason)): `deciding_thresholds` as a table
    thresholds = np.full((2, len(limits.threshold_small_box), 1 + max(Reason)), np.nan)
    for reason, large, percent in deciding_thresholds(limits):
        thresholds[int(large), :, reason] = percent
    for start in range(0, count, _BLOCK):
        rows = slice(start, start + _BLOCK)
        _decide_block(evidence, rows, limits, thresholds, decisions)
    apply_channels(evidence, config, decisions)
    if config.profile == "paper":
        _unmeasure_unknown(evidence, config, decisions)
    return decisions


def _unmeasure_unknown(
    evidence: Evidence, config: DecideConfig, decisions: Decisions
) -> None:
    """Make rejected boxes unmeasured that their unknown pixels could save.

    A pixel is unknown if its tag or colour is none of its family. The reason becomes
    UNKNOWN_PIXELS if the box would be kept if its unknown pixels matched.
    """
    is_open = (VERDICT_OF_REASON == REJECTED) & ~IS_FINAL
    rows = np.flatnonzero(
        (evidence.unknown_pixels > 0) & is_open.take(decisions.reason)
    )
    if not len(rows):
        return
    boxes = evidence.take(rows)
    matched = boxes.matched_pixels + boxes.unknown_pixels
    as_matched = replace(
        boxes,
        matched_pixels=matched,
        match_percent=100.0 * matched / np.maximum(boxes.box_pixels, 1),
        unknown_pixels=np.zeros_like(boxes.unknown_pixels),
        channels=with_more_pixels(boxes.channels, boxes.unknown_pixels),
    )
    spared = rows[decide(as_matched, config).reason == Reason.VISIBLE]
    decisions.overwrite(spared, Reason.UNKNOWN_PIXELS)


def _decide_block(
    evidence: Evidence,
    rows: slice,
    limits: LimitsByClass,
    thresholds: FloatArray,
    decisions: Decisions,
) -> None:
    """Decide the boxes in the range `rows`, and write the result into `decisions`."""
    class_index, area = evidence.class_index[rows], evidence.area_percent[rows]
    size = _per_box(limits.size_big_box, class_index)
    large = area >= size if _as_carlasimu(limits) else area > size
    # (N,) uint8: the reason of the first rule that holds for a box, else VISIBLE
    rules = _rules(evidence, rows, limits, large)
    reason = np.full(len(rules[0][1]), Reason.VISIBLE, np.uint8)
    # From the last rule to the first, so that the first one that holds is written last.
    for name, holds in reversed(rules):
        np.putmask(reason, holds, np.uint8(name))  # `np.select` is slower
    # `thresholds[large, class_index, reason]` by positions in the flattened table: with
    # numpy's indexing, `decide` would take a third longer.
    _, class_count, reason_count = thresholds.shape
    places = (large * np.int32(class_count) + class_index) * np.int32(reason_count)
    threshold: FloatArray = thresholds.take(places + reason)
    # Under carlasimu (see `_as_carlasimu`) the match can exceed 100: pixels are counted
    # between the box's corners without their decimals, but divided by the area of the
    # box as given. A box from x = 0.9 to 2.0 has 2 columns, but is 1.1 wide.
    margin = np.minimum(evidence.match_percent[rows], 100.0) - threshold
    decisions.reason[rows] = reason
    decisions.threshold[rows] = threshold
    decisions.margin[rows] = margin
    # (N,) bool: the 95 % Wilson interval of the match contains the threshold
    allowed = threshold * (100.0 - threshold)
    allowed *= Z95 * Z95
    deviation = margin * margin
    deviation *= evidence.box_pixels[rows]
    # False where there is no threshold: NaN compares as False.
    decisions.toss_up[rows] = deviation <= allowed
    # Not every large box, only those that a threshold decided.
    decisions.large[rows] = large & ~np.isnan(threshold)


def _as_carlasimu(limits: LimitsByClass) -> bool:
    """Whether to compare as under profile ``carlasimu``, the paper's published code.

    It differs from ``paper`` here in four ways (and in others where boxes are
    measured): a box whose class is not known is rejected; a box of exactly the size
    `size_big_box` is large; a match equal to a threshold fails; and large boxes must
    pass both thresholds.
    """
    return limits.profile == "carlasimu"


def _rules(
    evidence: Evidence, rows: slice, limits: LimitsByClass, large: BoolArray
) -> Sequence[_Rule]:
    """The rules in the order of Algorithm 2; a box for which none holds is visible.

    If you change how the match is compared, change the page's labels, too: they say
    whether it had to reach or to exceed the threshold (`measureText` in
    `static/js/boxes/wording.js`).
    """
    class_index, match = evidence.class_index[rows], evidence.match_percent[rows]
    small = _per_box(limits.threshold_small_box, class_index)
    big = _per_box(limits.threshold_big_box, class_index)
    needed = _per_box(limits.min_visible_pixels, class_index)
    if _as_carlasimu(limits):
        # Large boxes have to pass both thresholds: the small one applies to all boxes.
        fails_big, fails_small = (match <= big) & large, match <= small
    else:
        fails_big, fails_small = (match < big) & large, (match < small) & ~large
    state = evidence.state[rows]
    is_published = _as_carlasimu(limits)
    unmapped = Reason.DROPPED_CLASS if is_published else Reason.UNMAPPED_CLASS
    return (
        (Reason.OUTSIDE_IMAGE, state == BoxState.OUTSIDE_IMAGE.value),
        (Reason.COVERS_IMAGE, state == BoxState.COVERS_IMAGE.value),
        (Reason.DEGENERATE, state == BoxState.DEGENERATE.value),
        (Reason.OUT_OF_RANGE, state == BoxState.NOT_AHEAD.value),
        (Reason.OUT_OF_RANGE, _is_out_of_range(evidence, rows, limits)),
        (Reason.PASSED, limits.passed[class_index]),
        (unmapped, evidence.accept_mask[rows] == 0),
        (Reason.NO_SEGMENTATION, ~evidence.measured[rows]),
        (Reason.NO_VISIBLE_PIXELS, evidence.matched_pixels[rows] < needed),
        (Reason.LARGE_BELOW_THRESHOLD, fails_big),
        (Reason.BELOW_THRESHOLD, fails_small),
    )


class DecidingThreshold(NamedTuple):
    """The threshold that decided the boxes of one reason, large ones or others.

    `percent` is (K,) float64: the threshold of each class. NaN: it has no such boxes.
    """

    reason: Reason
    large: bool
    percent: FloatArray


def deciding_thresholds(limits: LimitsByClass) -> list[DecidingThreshold]:
    """Which threshold decided a box, by its reason and by whether it is large.

    The match of a VISIBLE box has reached the threshold, that of any other box has
    not. Boxes of all other reasons were decided by no threshold.
    """
    small, big = limits.threshold_small_box, limits.threshold_big_box
    both = _as_carlasimu(limits)  # whether large boxes have to pass both thresholds
    thresholds = [
        DecidingThreshold(Reason.VISIBLE, False, small),
        DecidingThreshold(Reason.BELOW_THRESHOLD, False, small),
        DecidingThreshold(
            Reason.VISIBLE, True, np.maximum(small, big) if both else big
        ),
        DecidingThreshold(Reason.LARGE_BELOW_THRESHOLD, True, big),
    ]
    if both:
        # Here a large box must reach both. If it has reached `big`, it can still be
        # below `small`, but only where `small` is the higher one.
        if_higher = np.where(small > big, small, np.nan)
        thresholds.append(DecidingThreshold(Reason.BELOW_THRESHOLD, True, if_higher))
    return thresholds


def _is_out_of_range(
    evidence: Evidence, rows: slice, limits: LimitsByClass
) -> BoolArray:
    # Without limits, `nearest` is -inf and `farthest` is inf.
    nearest, farthest = limits.min_distance, limits.max_distance
    class_index = evidence.class_index[rows]
    if np.isinf(nearest).all() and np.isinf(farthest).all():
        return np.zeros(len(class_index), np.bool_)
    low, high = evidence.distance_bounds(rows)
    # An unknown distance (NaN) is never out of range. A box that is between two
    # distances is farther than the lower one, unless this is the same.
    limit = _per_box(farthest, class_index)
    out_of_range = high < _per_box(nearest, class_index)
    out_of_range |= (low > limit) | ((low == limit) & (low < high))
    return out_of_range


def _per_box(
    per_class: FloatArray | IntArray, class_index: NDArray[np.int32]
) -> _PerBox:
    """The number of each box, from a (K,) array of numbers by class."""
    alike = bool((per_class == per_class[0]).all())
    chosen: _PerBox = per_class[0] if alike else per_class.take(class_index)
    return chosen
