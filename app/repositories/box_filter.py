"""Which boxes a list shows: conditions on current decisions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

from sqlalchemy import ColumnElement, and_, false, or_

from app.db.tables import Decision
from app.verdicts import REVIEW_STATES, is_effective, is_in_conflict, is_not_in_conflict
from filter_core.types import Reason, Verdict


class Side(NamedTuple):
    """Boxes of one class on one side of the threshold that decided them.

    Their match rises away from it (`sign` 1) or falls (-1).
    """

    reason: Reason
    large: bool
    threshold: float
    sign: int


@dataclass(frozen=True)
class ClassThresholds:
    """What the active config asks of a class, in percent.

    A large box has to reach `large` and, in the published code alone, `small` as well:
    `kept_large` is what that comes to.
    """

    class_id: int
    small: float
    large: float
    kept_large: float

    def sides(self) -> Iterator[Side]:
        """Every side on which there can be a box."""
        yield Side(Reason.VISIBLE, False, self.small, 1)
        yield Side(Reason.BELOW_THRESHOLD, False, self.small, -1)
        yield Side(Reason.VISIBLE, True, self.kept_large, 1)
        yield Side(Reason.LARGE_BELOW_THRESHOLD, True, self.large, -1)
        if self.kept_large > self.large:
            yield Side(Reason.BELOW_THRESHOLD, True, self.small, -1)


@dataclass(frozen=True)
class BoxFilter:
    """A selection of boxes; None or empty means any.

    `match_min` and what follows are ranges of numbers; tallies count by the others.
    """

    dataset_id: int
    reasons: tuple[int, ...] = ()
    class_ids: tuple[int, ...] | None = None
    review: str = ""
    effective: Verdict | None = None
    toss_up: bool | None = None
    conflict: bool | None = None
    match_min: float | None = None
    match_max: float | None = None
    margin_max: float | None = None
    distance_min: float | None = None
    distance_max: float | None = None
    thresholds: tuple[ClassThresholds, ...] = ()

    def conditions(self) -> list[ColumnElement[bool]]:
        """The selection as SQL."""
        return [Decision.dataset_id == self.dataset_id, *self._conditions()]

    def conditions_by_id(self) -> list[ColumnElement[bool]]:
        """The selection for boxes named by their ids: no other index is to be read."""
        return [Decision.dataset_id + 0 == self.dataset_id, *self._conditions()]

    def _conditions(self) -> list[ColumnElement[bool]]:
        found: list[ColumnElement[bool]] = []
        if self.reasons:
            found.append(Decision.reason.in_(self.reasons))
        if self.class_ids is not None:
            found.append(Decision.class_id.in_(self.class_ids))
        if self.review:
            found.append(REVIEW_STATES[self.review].condition())
        if self.effective is not None:
            found.append(is_effective(self.effective))
        if self.toss_up is not None:
            found.append(Decision.toss_up.is_(self.toss_up))
        if self.conflict is not None:
            found.append(is_in_conflict() if self.conflict else is_not_in_conflict())
        return found + self._ranges()

    def unanswered(self) -> list[ColumnElement[bool]]:
        """Said beside the conditions, the index of unanswered boxes may be read.

        The conditions alone do not say it in its words: it would be read wherever it
        is possible, also where another index leads to far fewer boxes.
        """
        return [Decision.review.is_(None)] if self.review == "none" else []

    @property
    def has_ranges(self) -> bool:
        """Whether boxes are chosen by their numbers, which no tally knows."""
        ranges = (
            *(self.match_min, self.match_max, self.margin_max),
            *(self.distance_min, self.distance_max),
        )
        return any(limit is not None for limit in ranges)

    @property
    def is_found_by_match(self) -> bool:
        """Whether an index on matches leads to the boxes, in an order of its own."""
        has_range = self.match_min is not None or self.match_max is not None
        return has_range and not self.only_answered

    @property
    def only_answered(self) -> bool:
        """Whether all of them were answered: few boxes, with an index of their own."""
        answers = REVIEW_STATES[self.review].answers if self.review else ("",)
        return "" not in answers or self.conflict is True

    def _ranges(self) -> list[ColumnElement[bool]]:
        found: list[ColumnElement[bool]] = []
        if self.match_min is not None:
            found.append(Decision.match_percent >= self.match_min)
        if self.match_max is not None:
            found.append(Decision.match_percent <= self.match_max)
        if self.distance_min is not None:
            found.append(Decision.distance >= self.distance_min)
        if self.distance_max is not None:
            found.append(Decision.distance <= self.distance_max)
        if self.margin_max is not None:
            found.append(is_near(self.thresholds, self.margin_max))
        return found


THRESHOLD_REASONS = (
    Reason.VISIBLE,
    Reason.BELOW_THRESHOLD,
    Reason.LARGE_BELOW_THRESHOLD,
)
"""Reasons of decisions that have a margin."""


def is_near(
    thresholds: Sequence[ClassThresholds], margin: float
) -> ColumnElement[bool]:
    """A threshold applied, and the match is within `margin` percent of it."""
    return _is_near(tuple(thresholds), margin)


@lru_cache(maxsize=256)
def _is_near(
    thresholds: tuple[ClassThresholds, ...], margin: float
) -> ColumnElement[bool]:
    # Kept: putting it together takes longer than asking for a page does. By class
    # first, so that a row is held against the sides of its own class alone.
    near = [
        and_(
            Decision.class_id == wanted.class_id,
            or_(*(_is_near_side(side, margin) for side in wanted.sides())),
        )
        for wanted in thresholds
    ]
    with_margin = Decision.reason.in_([int(reason) for reason in THRESHOLD_REASONS])
    return and_(with_margin, or_(*near)) if near else false()


def _is_near_side(side: Side, margin: float) -> ColumnElement[bool]:
    return and_(
        Decision.reason == int(side.reason),
        Decision.large.is_(side.large),
        Decision.match_percent.between(
            side.threshold - margin, side.threshold + margin
        ),
    )
