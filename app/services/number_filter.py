"""Filters of boxes on numbers in memory: a million are passed over in milliseconds."""

from __future__ import annotations

import numpy as np

from app.repositories.box_filter import BoxFilter
from app.services.numbers import DatasetNumbers
from filter_core.types import BoolArray, Decisions


def selected(
    numbers: DatasetNumbers, decisions: Decisions, wanted: BoxFilter
) -> BoolArray:
    """The filter by the comparisons of the database, but for what people answered.

    NaN is in no range.
    """
    evidence = numbers.evidence
    match, distance = evidence.match_percent, evidence.distance
    chosen = np.ones(len(numbers), np.bool_)
    if wanted.reasons:
        chosen &= np.isin(decisions.reason, wanted.reasons)
    if wanted.class_ids is not None:
        chosen &= np.isin(numbers.class_ids, wanted.class_ids)
    if wanted.toss_up is not None:
        chosen &= decisions.toss_up == wanted.toss_up
    if wanted.margin_max is not None:
        chosen &= match >= decisions.threshold - wanted.margin_max
        chosen &= match <= decisions.threshold + wanted.margin_max
    for column, low, high in (
        (match, wanted.match_min, wanted.match_max),
        (distance, wanted.distance_min, wanted.distance_max),
    ):
        if low is not None:
            chosen &= column >= low
        if high is not None:
            chosen &= column <= high
    return chosen
