"""Pages of boxes in the orders that people review in, each read off an index.

Doubt depends on thresholds that change, so it cannot be a column: a million rows would
have to be rewritten for every trial. The match does not change. Around a class's
threshold the index on (dataset, class, match) is already in order of doubt, upwards for
kept boxes and downwards for rejected ones: a page is a merge of these streams.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from sqlalchemy import (
    ColumnElement,
    Select,
    SQLColumnExpression,
    and_,
    case,
    literal,
    not_,
    or_,
    select,
    union_all,
)
from sqlalchemy.orm import Session

from app.db.tables import Decision
from app.errors import BadRequest
from app.repositories.box_filter import (
    THRESHOLD_REASONS,
    BoxFilter,
    ClassThresholds,
    Side,
    is_near,
)
from filter_core.types import Reason

ORDERS: Final = ("id", "doubt", "match_percent", "-match_percent", "crowding")
NEAR_PERCENT: Final = 5.0
"""A margin up to this makes a box doubtful even if no toss-up."""
CROWDED_PERCENT: Final = 50.0
"""From this share on, another box may have lent a hidden one its pixels."""
_EPSILON: Final = 1e-9
_MAX_ID: Final = 2**63 - 1


class Position(NamedTuple):
    """Where a page ended: the tier, the score in it, the stream, and the box."""

    tier: int
    score: float
    stream: int
    box_id: int


START: Final = Position(0, float("-inf"), -1, 0)


@dataclass(frozen=True)
class Stream:
    """Boxes in index order whose score rises by `sign` times a column."""

    column: SQLColumnExpression[Any]
    conditions: Sequence[ColumnElement[bool]]
    origin: float = 0.0
    sign: int = 1

    def score(self) -> ColumnElement[Any]:
        """Distance from the origin, rising along the stream."""
        return (self.column - self.origin) * self.sign

    def beyond(self, number: int, at: Position) -> list[ColumnElement[bool]]:
        """Only rows after a position, with a bound that the index can use."""
        if at.score == float("-inf"):
            return []
        value = self.origin + self.sign * at.score
        bound = (
            self.column >= value - _EPSILON
            if self.sign > 0
            else self.column <= value + _EPSILON
        )
        score, last = self.score(), self._last_id(number, at)
        later = Decision.box_id > last if self.sign > 0 else Decision.box_id < last
        return [bound, or_(score > at.score, and_(score == at.score, later))]

    def _last_id(self, number: int, at: Position) -> int:
        """The box after which rows of the same score are still to come.

        Streams before the one where the page ended gave all of theirs, those after it
        none. Said by a value, the statement is the same for every page, and compiled
        once.
        """
        if number == at.stream:
            return at.box_id
        has_all_to_come = number > at.stream
        return -1 if has_all_to_come == (self.sign > 0) else _MAX_ID

    def rows(self, number: int, at: Position, limit: int) -> Select[Any]:
        """The next rows of this stream alone."""
        order = (
            (self.column, Decision.box_id)
            if self.sign > 0
            else (self.column.desc(), Decision.box_id.desc())
        )
        inner = (
            select(
                self.score().label("score"),
                literal(number).label("stream"),
                Decision.box_id.label("box_id"),
            )
            .where(*self.conditions, *self.beyond(number, at))
            .order_by(*order)
            .limit(limit)
            .subquery()
        )
        return select(inner.c.score, inner.c.stream, inner.c.box_id)


class BoxPages:
    """Keyset pages over current decisions."""

    def __init__(self, session: Session, wanted: BoxFilter, present: Present) -> None:
        self._session = session
        self._wanted = wanted
        self._present = present

    def page(self, order: str, cursor: str, limit: int) -> tuple[list[int], str | None]:
        """Ids of the next boxes, and the cursor of the page after them."""
        at = _decode(cursor) if cursor else START
        found: list[Position] = []
        for tier, streams in enumerate(self._tiers(order)):
            if tier < at.tier or not streams:
                continue
            start = at if tier == at.tier else START
            found += self._merge(tier, streams, start, limit + 1 - len(found))
            if len(found) > limit:
                break
        more = len(found) > limit
        found = found[:limit]
        cursor_after = _encode(found[-1]) if more and found else None
        return [position.box_id for position in found], cursor_after

    def _merge(
        self, tier: int, streams: Sequence[Stream], at: Position, limit: int
    ) -> list[Position]:
        parts = [
            stream.rows(number, at, limit) for number, stream in enumerate(streams)
        ]
        query = union_all(*parts) if len(parts) > 1 else parts[0]
        rows = [
            (float(row[0]), int(row[1]), int(row[2]))
            for row in self._session.execute(query)
        ]
        rows.sort(key=lambda row: (row[0], row[1], row[2] * streams[row[1]].sign))
        return [Position(tier, *row) for row in rows[:limit]]

    def _tiers(self, order: str) -> Iterator[Sequence[Stream]]:
        if order == "doubt":
            yield from self._doubt()
        elif order == "id":
            yield self._by_id()
        elif order == "crowding":
            yield [self._crowding([])]
        else:
            yield self._by_match(1 if order == "match_percent" else -1)
            yield self._by_id(Decision.match_percent.is_(None))

    def _by_id(self, *conditions: ColumnElement[bool]) -> list[Stream]:
        # One stream per reason: "reason in (...) order by id" would sort them all.
        # Without reasons one per class: no index is by dataset and id alone. Those
        # that people answered are few, and have an index of their own.
        wanted = self._wanted
        every = [*wanted.conditions(), *conditions]
        if wanted.only_answered:
            return [Stream(Decision.box_id, every)]
        if wanted.reasons:
            reasons = [r for r in self._present.reasons if r in wanted.reasons]
            parts = [Decision.reason == reason for reason in reasons]
        else:
            parts = [Decision.class_id == class_id for class_id in self._class_ids()]
        return [Stream(Decision.box_id, [*every, part]) for part in parts]

    def _by_match(self, sign: int) -> list[Stream]:
        every = self._wanted.conditions()
        if self._wanted.only_answered:
            known = Decision.match_percent.is_not(None)
            return [
                Stream(self._column(Decision.match_percent), [*every, known], sign=sign)
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

    def _crowding(self, conditions: Sequence[ColumnElement[bool]]) -> Stream:
        every = [*self._wanted.conditions(), *conditions]
        return Stream(self._column(Decision.crowding), every, sign=-1)

    def _column(self, column: SQLColumnExpression[Any]) -> SQLColumnExpression[Any]:
        # Of few boxes, found by their answers, no other index is to be read.
        return column + 0 if self._wanted.only_answered else column

    def _doubt(self) -> Iterator[Sequence[Stream]]:
        """Toss-ups; near the threshold; kept and crowded; the rest; no threshold."""
        if self._present.toss_ups and self._wanted.toss_up is not False:
            yield self._around([Decision.toss_up.is_(True)], rare=True)
        else:
            yield []
        if self._wanted.toss_up:  # none of them is in what follows
            return
        plain = Decision.toss_up.is_(False)
        yield self._around([plain], within=NEAR_PERCENT)
        # Built only now: most pages end before they get here.
        near = is_near(self._thresholds(), NEAR_PERCENT)
        crowded = and_(
            self._column(Decision.reason) == int(Reason.VISIBLE),
            self._column(Decision.crowding) >= CROWDED_PERCENT,
        )
        yield [self._crowding([plain, not_(near), crowded])]
        yield self._around([plain, not_(near), not_(crowded)])
        others = [
            reason
            for reason in self._present.reasons
            if reason not in [int(known) for known in THRESHOLD_REASONS]
            and (not self._wanted.reasons or reason in self._wanted.reasons)
        ]
        every = self._wanted.conditions()
        yield [
            Stream(Decision.box_id, [*every, self._column(Decision.reason) == reason])
            for reason in others
        ]

    def _around(
        self,
        conditions: Sequence[ColumnElement[bool]],
        within: float | None = None,
        *,
        rare: bool = False,
    ) -> list[Stream]:
        every = [*self._wanted.conditions(), *conditions]
        if self._wanted.only_answered:
            return self._around_answered(every, within)
        found = []
        for wanted in self._thresholds():
            for side in wanted.sides():
                if not self._occurs(side):
                    continue
                those = [
                    *every,
                    Decision.class_id == wanted.class_id,
                    Decision.large.is_(side.large),
                    Decision.reason == int(side.reason),
                    *_bounds(side, within),
                    *([] if rare or side.large else self._wanted.unanswered()),
                ]
                found.append(
                    Stream(Decision.match_percent, those, side.threshold, side.sign)
                )
        return found

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
        if side.large and not self._present.large:
            return False
        return not self._wanted.reasons or side.reason in self._wanted.reasons

    def _class_ids(self) -> list[int]:
        return [wanted.class_id for wanted in self._thresholds()]

    def _thresholds(self) -> list[ClassThresholds]:
        wanted = self._wanted.class_ids
        return [
            each
            for each in self._wanted.thresholds
            if each.class_id in self._present.class_ids
            and (wanted is None or each.class_id in wanted)
        ]


@dataclass(frozen=True)
class Present:
    """What occurs in a dataset, so that no stream is opened in vain."""

    reasons: tuple[int, ...]
    class_ids: frozenset[int]
    toss_ups: bool
    large: bool


def _bounds(side: Side, within: float | None) -> list[ColumnElement[bool]]:
    column, threshold = Decision.match_percent, side.threshold
    inner = column >= threshold if side.sign > 0 else column <= threshold
    if within is None:
        return [inner]
    limit = threshold + side.sign * within
    return [inner, column <= limit if side.sign > 0 else column >= limit]


def _encode(position: Position) -> str:
    text = json.dumps(list(position), separators=(",", ":"))
    return base64.urlsafe_b64encode(text.encode()).decode().rstrip("=")


def _decode(cursor: str) -> Position:
    try:
        padded = cursor + "=" * (-len(cursor) % 4)
        tier, score, stream, box_id = json.loads(base64.urlsafe_b64decode(padded))
        position = Position(int(tier), float(score), int(stream), int(box_id))
        if not all(-_MAX_ID <= number <= _MAX_ID for number in position):
            raise ValueError(position)
        return position
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        raise BadRequest(f"cursor {cursor!r} is not one of ours") from error
