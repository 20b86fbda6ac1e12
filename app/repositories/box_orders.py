"""The orders that people review in: each is tiers, and a tier is streams of an index.

Doubt depends on thresholds that change, so it cannot be a column: a million rows would
have to be rewritten for every trial. The match does not change. Around a class's
threshold the index on (dataset, class, match) is already in order of doubt, upwards for
kept boxes and downwards for rejected ones: a page is a merge of these streams.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from sqlalchemy import ColumnElement, SQLColumnExpression, and_, case, not_

from app.db.tables import Decision
from app.repositories.box_filter import (
    THRESHOLD_REASONS,
    BoxFilter,
    ClassThresholds,
    Side,
    is_near,
)
from app.repositories.box_streams import Stream
from filter_core.types import Reason

NEAR_PERCENT: Final = 5.0
"""A margin up to this makes a box doubtful even if no toss-up."""
CROWDED_PERCENT: Final = 50.0
"""From this share on, another box may have lent a hidden one its pixels."""


@dataclass(frozen=True)
class Present:
    """What occurs in a dataset, so that no stream is opened in vain."""

    reasons: tuple[int, ...]
    class_ids: frozenset[int]
    toss_ups: bool
    large: bool


@dataclass(frozen=True)
class BoxOrder:
    """The streams of each tier for one filter; all boxes of a tier precede the next."""

    wanted: BoxFilter
    present: Present

    def by_id(self) -> list[Stream]:
        """In the order of their ids."""
        return self._by_id()

    def by_match(self, sign: int) -> list[Stream]:
        """By their match, upwards or downwards."""
        every = self.wanted.conditions()
        if self.wanted.only_answered:
            known = Decision.match_percent.is_not(None)
            column = self._column(Decision.match_percent)
            return [Stream(column, [*every, known], sign=sign)]
        if self.wanted.margin_max is not None:
            return [
                Stream(Decision.match_percent, conditions, sign=sign)
                for _, conditions in self._sides([], self.wanted.margin_max)
            ]
        return [
            Stream(
                Decision.match_percent,
                [
                    *every,
                    Decision.class_id == class_id,
                    Decision.match_percent.is_not(None),
                ],
                sign=sign,
            )
            for class_id in self._class_ids()
        ]

    def unmatched(self) -> list[Stream]:
        """Those without a match, by id."""
        return self._by_id(Decision.match_percent.is_(None))

    def by_crowding(self) -> list[Stream]:
        """The most crowded first."""
        return self._crowding([])

    def toss_ups(self) -> list[Stream]:
        """Toss-ups, the nearest to their threshold first."""
        if not self.present.toss_ups or self.wanted.toss_up is False:
            return []
        return self._around([Decision.toss_up.is_(True)], rare=True)

    def near(self) -> list[Stream]:
        """Others near their threshold."""
        if self.wanted.toss_up:
            return []
        return self._around([Decision.toss_up.is_(False)], NEAR_PERCENT)

    def crowded(self) -> list[Stream]:
        """Others that are kept and crowded."""
        if not self._goes_beyond_near():
            return []
        far = not_(is_near(self._thresholds(), NEAR_PERCENT))
        return self._crowding([Decision.toss_up.is_(False), far, self._is_crowded()])

    def far(self) -> list[Stream]:
        """All others that a threshold decided."""
        if not self._goes_beyond_near():
            return []
        far = not_(is_near(self._thresholds(), NEAR_PERCENT))
        plain = Decision.toss_up.is_(False)
        return self._around([plain, far, not_(self._is_crowded())])

    def without_threshold(self) -> list[Stream]:
        """Those that no threshold decided, by reason and id."""
        if not self._goes_beyond_near():
            return []
        others = [
            reason
            for reason in self.present.reasons
            if reason not in [int(known) for known in THRESHOLD_REASONS]
            and (not self.wanted.reasons or reason in self.wanted.reasons)
        ]
        every = replace(self.wanted, reasons=()).conditions()
        return [
            Stream(Decision.box_id, [*every, self._column(Decision.reason) == reason])
            for reason in others
        ]

    def _goes_beyond_near(self) -> bool:
        """Whether there can be boxes that are neither toss-ups nor near."""
        most = self.wanted.margin_max
        return not self.wanted.toss_up and (most is None or most > NEAR_PERCENT)

    def _by_id(self, *conditions: ColumnElement[bool]) -> list[Stream]:
        # One stream per reason: "reason in (...) order by id" would sort them all.
        # Without reasons one per class: no index is by dataset and id alone. Those
        # that people answered are few, and have an index of their own.
        wanted = self.wanted
        if wanted.only_answered:
            return [Stream(Decision.box_id, [*wanted.conditions(), *conditions])]
        # Said beside "reason = ...", "reason in (...)" may be what an index is read by.
        every = [*replace(wanted, reasons=()).conditions(), *conditions]
        if wanted.reasons:
            reasons = [r for r in self.present.reasons if r in wanted.reasons]
            parts = [Decision.reason == reason for reason in reasons]
        else:
            parts = [Decision.class_id == class_id for class_id in self._class_ids()]
        return [Stream(Decision.box_id, [*every, part]) for part in parts]

    def _crowding(self, conditions: Sequence[ColumnElement[bool]]) -> list[Stream]:
        every = [*self.wanted.conditions(), *conditions]
        return [Stream(self._column(Decision.crowding), every, sign=-1)]

    def _is_crowded(self) -> ColumnElement[bool]:
        return and_(
            self._column(Decision.reason) == int(Reason.VISIBLE),
            self._column(Decision.crowding) >= CROWDED_PERCENT,
        )

    def _column(self, column: SQLColumnExpression[Any]) -> SQLColumnExpression[Any]:
        # Of few boxes, found by their answers, no other index is to be read.
        return column + 0 if self.wanted.only_answered else column

    def _around(
        self,
        conditions: Sequence[ColumnElement[bool]],
        within: float | None = None,
        *,
        rare: bool = False,
    ) -> list[Stream]:
        if self.wanted.only_answered:
            every = [*self.wanted.conditions(), *conditions]
            return self._around_answered(every, within)
        margins = (within, self.wanted.margin_max)
        within = min((each for each in margins if each is not None), default=None)
        return [
            Stream(
                Decision.match_percent,
                [*each, *([] if rare or side.large else self.wanted.unanswered())],
                side.threshold,
                side.sign,
            )
            for side, each in self._sides(conditions, within)
        ]

    def _sides(
        self, conditions: Sequence[ColumnElement[bool]], within: float | None
    ) -> Iterator[tuple[Side, list[ColumnElement[bool]]]]:
        """Each side of each class's thresholds, and the conditions of its boxes.

        Along one side of one threshold a margin is an end of the index. As the filter
        says it, every row would be held against all sides of all classes.
        """
        every = [*replace(self.wanted, margin_max=None).conditions(), *conditions]
        for wanted in self._thresholds():
            for side in filter(self._occurs, wanted.sides()):
                yield (
                    side,
                    [
                        *every,
                        Decision.class_id == wanted.class_id,
                        Decision.large.is_(side.large),
                        Decision.reason == int(side.reason),
                        *_bounds(side, within),
                    ],
                )

    def _around_answered(
        self, every: Sequence[ColumnElement[bool]], within: float | None
    ) -> list[Stream]:
        # Few boxes, found by their answers: sorting them is quicker than passing by
        # all the others on the way along the matches.
        distances = [
            (
                and_(
                    Decision.class_id == wanted.class_id,
                    Decision.large.is_(side.large),
                    Decision.reason == int(side.reason),
                ),
                (Decision.match_percent - side.threshold) * side.sign,
            )
            for wanted in self._thresholds()
            for side in wanted.sides()
            if self._occurs(side)
        ]
        if not distances:
            return []
        distance = case(*distances)
        bounds = [distance >= 0] if within is None else [distance.between(0, within)]
        return [Stream(distance, [*every, *bounds])]

    def _occurs(self, side: Side) -> bool:
        if side.large and not self.present.large:
            return False
        return not self.wanted.reasons or side.reason in self.wanted.reasons

    def _class_ids(self) -> list[int]:
        return [wanted.class_id for wanted in self._thresholds()]

    def _thresholds(self) -> list[ClassThresholds]:
        wanted = self.wanted.class_ids
        return [
            each
            for each in self.wanted.thresholds
            if each.class_id in self.present.class_ids
            and (wanted is None or each.class_id in wanted)
        ]


Tier = Callable[[BoxOrder], list[Stream]]

TIERS: Final[Mapping[str, Sequence[Tier]]] = {
    "id": (BoxOrder.by_id,),
    "doubt": (
        BoxOrder.toss_ups,
        BoxOrder.near,
        BoxOrder.crowded,
        BoxOrder.far,
        BoxOrder.without_threshold,
    ),
    "match_percent": (lambda order: order.by_match(1), BoxOrder.unmatched),
    "-match_percent": (lambda order: order.by_match(-1), BoxOrder.unmatched),
    "crowding": (BoxOrder.by_crowding,),
}
"""The tiers of each order, built one by one: most pages end in the first."""


def _bounds(side: Side, within: float | None) -> list[ColumnElement[bool]]:
    column, threshold = Decision.match_percent, side.threshold
    inner = column >= threshold if side.sign > 0 else column <= threshold
    if within is None:
        return [inner]
    limit = threshold + side.sign * within
    return [inner, column <= limit if side.sign > 0 else column >= limit]
