"""Counting a million boxes at once: one pass per question over narrow columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from filter_core.config.filter import FilterConfig
from filter_core.types import (
    VERDICT_OF_REASON,
    VERDICTS,
    Decisions,
    Evidence,
    IntArray,
    Reason,
)
from unghost.wire.datasets import Histogram
from unghost.wire.runs import Flip, FlipSide

REASONS: Final = len(VERDICT_OF_REASON)
"""Columns of a table by reason."""
_MAX_PERCENT: Final = 100.0


def reason_counts(evidence: Evidence, decisions: Decisions) -> IntArray:
    """(classes, reasons): how many boxes of each class got each reason."""
    packed = evidence.class_index * np.int32(REASONS) + decisions.reason
    cells = len(evidence.class_names) * REASONS
    table: IntArray = np.bincount(packed, minlength=cells).reshape(-1, REASONS)
    return table


def outcome(names: Sequence[str], table: IntArray) -> dict[str, Any]:
    """How many boxes got each verdict and reason, altogether and per class."""
    per_reason = table.sum(axis=0)
    verdicts = np.zeros((len(names), len(VERDICTS)), np.int64)
    for reason in Reason:
        verdicts[:, VERDICT_OF_REASON[reason]] += table[:, reason]
    return {
        "counts": _by_verdict(verdicts.sum(axis=0)),
        "by_reason": {
            reason.label: int(per_reason[reason])
            for reason in Reason
            if per_reason[reason]
        },
        "by_class": {
            name: _by_verdict(row)
            for name, row in zip(names, verdicts, strict=True)
            if row.any()
        },
        "reasons_by_class": {
            name: {reason.label: int(row[reason]) for reason in Reason if row[reason]}
            for name, row in zip(names, table, strict=True)
            if row.any()
        },
    }


def flip_of(
    ids: tuple[int, int], evidence: Evidence, row: int, reasons: tuple[int, int]
) -> Flip:
    """A box that is decided otherwise.

    Parameters
    ----------
    ids : (int, int)
        Of the box and of its frame.
    evidence : Evidence
        Of the second decision; `row` is the box's.
    reasons : (int, int)
        Codes of `Reason`: before, and after.
    """
    before, after = (Reason(code) for code in reasons)
    match = float(evidence.match_percent[row])
    return Flip(
        box_id=ids[0],
        frame_id=ids[1],
        class_name=evidence.class_names[int(evidence.class_index[row])],
        match_percent=None if match != match else match,
        before=FlipSide(verdict=before.verdict.value, reason=before.label),
        after=FlipSide(verdict=after.verdict.value, reason=after.label),
    )


def match_counts(evidence: Evidence, bins: int) -> IntArray:
    """(classes, bins): measured boxes by match_percent, in equal bins from 0 to 100."""
    match = evidence.match_percent[evidence.measured]
    # What has no match (outside, degenerate) is no part of a histogram of matches.
    known = match == match
    scaled = match[known] * (bins / _MAX_PERCENT)
    bin_of = np.minimum(scaled.astype(np.int32), bins - 1)
    packed = evidence.class_index[evidence.measured][known] * np.int32(bins) + bin_of
    counts = np.bincount(packed, minlength=len(evidence.class_names) * bins)
    table: IntArray = counts.reshape(-1, bins)
    return table


def histogram(
    names: Sequence[str], counts: IntArray, config: FilterConfig
) -> Histogram:
    """The counts of classes that occur, with the thresholds of a configuration."""
    limits = config.thresholds_for(names).threshold_small_box
    occurs = np.flatnonzero(counts.sum(axis=1)).tolist()
    return Histogram(
        edges=np.linspace(0.0, _MAX_PERCENT, counts.shape[1] + 1).tolist(),
        classes={names[index]: counts[index].tolist() for index in occurs},
        thresholds={names[index]: float(limits[index]) for index in occurs},
    )


def _by_verdict(counts: IntArray) -> dict[str, int]:
    return {
        verdict.value: int(count)
        for verdict, count in zip(VERDICTS, counts, strict=True)
    }
