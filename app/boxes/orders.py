"""Pages of boxes in the orders of lists and the queue, read from indexes.

Doubt orders boxes by the distance of their match to a threshold. That distance is not a
column: when a threshold changes, a million rows would have to be rewritten. But the
index on (dataset, class, match), read from a class's threshold on, is in the order of
the distance: upwards for kept boxes, downwards for rejected ones. Each such index scan
is a `Stream`; a page is merged from the streams of all classes. With hundreds of
classes there would be thousands of streams: then the database computes the distance of
each box and sorts (`MOST_KINDS`).
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final, NamedTuple, TypeAlias

from sqlalchemy import (
    ColumnElement,
    CompoundSelect,
    Float,
    Select,
    SQLColumnExpression,
    and_,
    bindparam,
    case,
    func,
    literal,
    not_,
    or_,
    select,
    union_all,
)
from sqlalchemy.orm import Session

from app.boxes.filter import (
    BoxFilter,
    BoxProbes,
    ClassThresholds,
    Side,
    is_near,
    reasons_with_threshold,
    thresholds_in_sql,
)
from app.db.base import MAX_ID, Key
from app.db.bulk import chunks
from app.db.tables import Decision
from app.errors import BadCursor
from filter_core.types import Reason

NEAR_PERCENT: Final = 5.0
"""Boxes with a margin up to this come right after the toss-ups."""
CROWDED_PERCENT: Final = 50.0
"""From this crowding on, the matched pixels may belong to another box."""

MOST_KINDS: Final = 1000
"""With more kinds of boxes (see `DatasetContents`), the database sorts by distance."""

_EPSILON: Final = 1e-9


@dataclass(frozen=True)
class DatasetContents:
    """What occurs in a dataset: streams for anything else would be empty.

    `kinds` are the combinations of class, reason and toss-up flag.
    """

    reasons: tuple[int, ...]
    class_ids: frozenset[int]
    kinds: frozenset[tuple[int, int, bool]]
    large: bool

    def has(self, class_id: int, reason: Reason, toss_up: bool | None) -> bool:
        """Whether boxes of this kind occur; None: toss-ups or others."""
        flags = (True, False) if toss_up is None else (toss_up,)
        return any((class_id, int(reason), flag) in self.kinds for flag in flags)


@dataclass(frozen=True)
class BoxOrder:
    """Builds the streams of each tier, for one filter.

    An order consists of tiers: all boxes of a tier come before those of the next one.
    """

    wanted: BoxFilter
    contents: DatasetContents

    def by_id(self, *conditions: ColumnElement[bool]) -> list[Stream]:
        """The boxes that meet these conditions too, by id."""
        # One stream per reason: "reason in (...) order by id" would sort all rows.
        # Without reasons, one per class, since no index has the dataset and id alone.
        # Answered boxes are few, and have an index of their own.
        wanted = self.wanted
        if wanted.only_answered:
            return [Stream(Decision.box_id, [*wanted.conditions(), *conditions])]
        if not wanted.reasons:
            parts = self._by_class()
        else:
            # Without "reason in (...)": a database may prefer it to "reason = ...".
            every = replace(wanted, reasons=()).conditions()
            reasons = [r for r in self.contents.reasons if r in wanted.reasons]
            parts = [[*every, Decision.reason == reason] for reason in reasons]
        return [Stream(Decision.box_id, [*part, *conditions]) for part in parts]

    def by_match(self, sign: int) -> list[Stream]:
        """Boxes with a match, by match: ascending if `sign` is 1, descending if -1."""
        column, margin = self._column(Decision.match_percent), self.wanted.margin_max
        known = Decision.match_percent.is_not(None)
        if self.wanted.only_answered or (
            margin is not None and self._has_too_many_sides
        ):
            parts = [[*self.wanted.conditions(), known]]
        elif margin is not None:
            parts = [conditions for _, conditions in self._sides(margin)]
        else:
            parts = [[*conditions, known] for conditions in self._by_class()]
        return [Stream(column, conditions, sign=sign) for conditions in parts]

    def unmatched(self) -> list[Stream]:
        """Boxes without a match, by id."""
        return self.by_id(Decision.match_percent.is_(None))

    def by_crowding(self, *conditions: ColumnElement[bool]) -> list[Stream]:
        """The boxes that meet these conditions too, the most crowded first."""
        every = [*self.wanted.conditions(), *conditions]
        return [Stream(self._column(Decision.crowding), every, sign=-1)]

    def toss_ups(self) -> list[Stream]:
        """Toss-ups, the nearest to their threshold first."""
        if self.wanted.toss_up is False:
            return []
        return self._around(toss_up=True)

    def near(self) -> list[Stream]:
        """Boxes near their threshold that are not toss-ups."""
        if self.wanted.toss_up:
            return []
        return self._around(toss_up=False, within=NEAR_PERCENT)

    def crowded(self) -> list[Stream]:
        """Kept and crowded boxes in no tier above."""
        if not self._goes_beyond_near():
            return []
        far = not_(is_near(self._thresholds(), NEAR_PERCENT))
        return self.by_crowding(Decision.toss_up.is_(False), far, self._is_crowded())

    def far(self) -> list[Stream]:
        """All other boxes that a threshold decided."""
        if not self._goes_beyond_near():
            return []
        not_crowded = not_(self._is_crowded())
        return self._around(not_crowded, toss_up=False, beyond=NEAR_PERCENT)

    def without_threshold(self) -> list[Stream]:
        """Boxes that no threshold decided and boxes without a match, by id."""
        if not self._goes_beyond_near():
            return []
        decided = reasons_with_threshold(self.wanted.thresholds)
        others = [
            reason
            for reason in self.contents.reasons
            if reason not in decided
            and (not self.wanted.reasons or reason in self.wanted.reasons)
        ]
        every = replace(self.wanted, reasons=()).conditions()
        parts = [[self._column(Decision.reason) == reason] for reason in others]
        parts += self._kept_without_match()
        return [Stream(Decision.box_id, [*every, *part]) for part in parts]

    def _kept_without_match(self) -> list[list[ColumnElement[bool]]]:
        """Conditions, by class, for boxes without a match that a channel kept."""
        if self.wanted.reasons and int(Reason.VISIBLE) not in self.wanted.reasons:
            return []
        return [
            [
                Decision.class_id == each.class_id,
                Decision.reason == int(Reason.VISIBLE),
                self._column(Decision.match_percent).is_(None),
            ]
            for each in self._thresholds()
            if each.if_by_channel is not None
        ]

    def _goes_beyond_near(self) -> bool:
        """Whether there can be boxes that are neither toss-ups nor near."""
        most = self.wanted.margin_max
        return not self.wanted.toss_up and (most is None or most > NEAR_PERCENT)

    def _by_class(self) -> list[list[ColumnElement[bool]]]:
        """The conditions of the boxes of each class."""
        # A condition on margins compares only with the thresholds of that class.
        return [
            [
                *replace(self.wanted, thresholds=(each,)).conditions(),
                Decision.class_id == each.class_id,
            ]
            for each in self._thresholds()
        ]

    def _is_crowded(self) -> ColumnElement[bool]:
        return and_(
            self._column(Decision.reason) == int(Reason.VISIBLE),
            self._column(Decision.crowding) >= CROWDED_PERCENT,
        )

    def _column(
        self, column: SQLColumnExpression[float | None]
    ) -> SQLColumnExpression[float | None]:
        # "+ 0" prevents the use of an index on this column: answered boxes are few, and
        # the index on answers finds them.
        return column + 0 if self.wanted.only_answered else column

    def _around(
        self,
        *conditions: ColumnElement[bool],
        toss_up: bool,
        within: float | None = None,
        beyond: float | None = None,
    ) -> list[Stream]:
        """Boxes that a threshold decided, the nearest to it first.

        Those with a margin of up to `within`, or of more than `beyond`.
        """
        flag = Decision.toss_up.is_(toss_up)
        if self.wanted.only_answered or self._has_too_many_sides:
            return self._sorted_around(flag, *conditions, within=within, beyond=beyond)
        margins = (within, self.wanted.margin_max)
        within = min((each for each in margins if each is not None), default=None)
        sides = self._sides(within, flag, *conditions, toss_up=toss_up, beyond=beyond)
        return [
            Stream(
                Decision.match_percent,
                # Toss-ups are rare, and so are large boxes.
                [*each, *([] if toss_up or side.large else self.wanted.unanswered())],
                side.threshold,
                side.sign,
            )
            for side, each in sides
        ]

    def _sides(
        self,
        within: float | None,
        *conditions: ColumnElement[bool],
        toss_up: bool | None = None,
        beyond: float | None = None,
    ) -> Iterator[tuple[Side, list[ColumnElement[bool]]]]:
        """Each side of each class's thresholds, and the conditions of its boxes.

        For one side of one threshold, a margin is a range of the index. The filter's
        own condition on margins would compare every row with all thresholds.
        """
        every = [*replace(self.wanted, margin_max=None).conditions(), *conditions]
        for wanted in self._thresholds():
            for side in wanted.sides:
                if self._occurs(wanted.class_id, side, toss_up):
                    yield (
                        side,
                        [
                            *every,
                            Decision.class_id == wanted.class_id,
                            Decision.large.is_(side.large),
                            Decision.reason == int(side.reason),
                            *_bounds(side, within, beyond),
                        ],
                    )

    def _sorted_around(
        self,
        *conditions: ColumnElement[bool],
        within: float | None,
        beyond: float | None,
    ) -> list[Stream]:
        # One stream, which the database sorts. Answered boxes are few: finding them by
        # their answers and sorting them is faster than an index scan by match, which
        # reads all others too.
        thresholds = self._thresholds()
        distances = [
            (which, func.abs(Decision.match_percent - threshold))
            for which, threshold in thresholds_in_sql(thresholds)
        ]
        if not distances:
            return []
        every = [*self.wanted.conditions(), *conditions]
        if within is not None:
            every.append(is_near(thresholds, within))
        if beyond is not None:
            every.append(not_(is_near(thresholds, beyond)))
        distance = case(*distances)
        return [Stream(distance, [*every, distance.is_not(None)])]

    @property
    def _has_too_many_sides(self) -> bool:
        # Building and compiling a statement of so many streams would take seconds.
        return len(self.contents.kinds) > MOST_KINDS

    def _occurs(self, class_id: int, side: Side, toss_up: bool | None) -> bool:
        if side.large and not self.contents.large:
            return False
        if self.wanted.reasons and side.reason not in self.wanted.reasons:
            return False
        return self.contents.has(class_id, side.reason, toss_up)

    def _thresholds(self) -> list[ClassThresholds]:
        wanted = self.wanted.class_ids
        return [
            each
            for each in self.wanted.thresholds
            if each.class_id in self.contents.class_ids
            and (wanted is None or each.class_id in wanted)
        ]


class Position(NamedTuple):
    """Where a page ended: its last box, and the stream of that box.

    A cursor encodes these numbers. `tier` is an index into the tiers of the order,
    `stream` into the streams of the tier; `score` is the sort key of the stream.
    """

    tier: int
    score: float
    stream: int
    box_id: int


@dataclass(frozen=True)
class Stream:
    """Boxes in the order of an index: by ``(column - origin) * sign``, their score."""

    column: SQLColumnExpression[float | None]
    conditions: Sequence[ColumnElement[bool]]
    origin: float = 0.0
    sign: int = 1

    def score(self) -> ColumnElement[float | None]:
        """The score, which increases along the stream."""
        return (self.column - self.origin) * self.sign

    def beyond(self, number: int) -> list[ColumnElement[bool]]:
        """Conditions for the rows after a position, which `parameters` has.

        The index can use the first.
        """
        bound = bindparam(f"bound_{number}", type_=Float)
        in_reach = self.column >= bound if self.sign > 0 else self.column <= bound
        score, last = self.score(), bindparam(f"last_{number}", type_=Key)
        reached = bindparam("score", type_=Float)
        later = Decision.box_id > last if self.sign > 0 else Decision.box_id < last
        return [in_reach, or_(score > reached, and_(score == reached, later))]

    def parameters(self, number: int, at: Position) -> dict[str, float | int]:
        """The values of `beyond` for a position, besides its ``score``."""
        bound = self.origin + self.sign * (at.score - _EPSILON)
        return {f"bound_{number}": bound, f"last_{number}": self._last_id(number, at)}

    def _last_id(self, number: int, at: Position) -> int:
        """The id of the last box returned among the rows with the position's score.

        Streams before the one where the page ended have returned all rows of that
        score, streams after it none. Both cases are expressed by an id, so that all
        pages have the same statement, which is built and compiled once.
        """
        if number == at.stream:
            return at.box_id
        has_all_to_come = number > at.stream
        return -1 if has_all_to_come == (self.sign > 0) else MAX_ID

    def rows(
        self, number: int, limit: int, *, is_first: bool
    ) -> Select[float | None, int, int]:
        """The first rows of this stream alone, or the next."""
        order = (
            (self.column, Decision.box_id)
            if self.sign > 0
            else (self.column.desc(), Decision.box_id.desc())
        )
        beyond = [] if is_first else self.beyond(number)
        inner = (
            select(
                self.score().label("score"),
                literal(number).label("stream"),
                Decision.box_id.label("box_id"),
            )
            .where(*self.conditions, *beyond)
            .order_by(*order)
            .limit(limit)
            .subquery()
        )
        return select(inner.c.score, inner.c.stream, inner.c.box_id)


def _bounds(
    side: Side, within: float | None, beyond: float | None
) -> list[ColumnElement[bool]]:
    """The range of matches on this side, up to `within` and from `beyond` on."""
    column, threshold = Decision.match_percent, side.threshold
    if beyond is not None:
        limit = threshold + side.sign * beyond
        inner = column > limit if side.sign > 0 else column < limit
    elif side.sign > 0:
        inner = column >= threshold
    elif side.reason is Reason.VISIBLE:
        inner = column < threshold
    else:
        inner = column <= threshold
    if within is None:
        return [inner]
    limit = threshold + side.sign * within
    return [inner, column <= limit if side.sign > 0 else column >= limit]


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
"""The tiers of each order; a tier is built only when those before it have ended."""

ORDERS: Final = tuple(TIERS)
WINDOW: Final = 1 << 14
"""How many ids are scanned in order before all boxes of a range are sorted instead."""

_NO_STREAM: Final = 1 << 30
"""A number above those of all streams, for boxes that no stream returned."""

START: Final = Position(0, float("-inf"), -1, 0)


class BoxPages:
    """Keyset pagination of current decisions: pages begin where the last one ended."""

    def __init__(
        self, session: Session, wanted: BoxFilter, contents: DatasetContents
    ) -> None:
        self._session = session
        self._wanted = wanted
        self._streams = BoxOrder(wanted, contents)

    def page(
        self, order: str, cursor: str | None, limit: int
    ) -> tuple[list[int], str | None]:
        """Ids of the next boxes, and the cursor of the page after them."""
        at = decode(cursor) if cursor else START
        found: list[Position] = []
        for tier in range(at.tier, len(TIERS[order])):
            start = at if tier == at.tier else START
            asked = _TierRequest(self._streams, order, tier, limit + 1 - len(found))
            found += self._next_of(asked, start)
            if len(found) > limit:
                break
        more = len(found) > limit
        found = found[:limit]
        cursor_after = encode(found[-1]) if more and found else None
        return [position.box_id for position in found], cursor_after

    def _next_of(self, asked: _TierRequest, at: Position) -> list[Position]:
        if asked.order == "id" and self._wanted.is_found_by_match:
            found = self._in_window(asked, at)
            if len(found) == asked.limit:
                return found
        return self._merged(asked, at)

    def _in_window(self, asked: _TierRequest, at: Position) -> list[Position]:
        # The index returns the boxes of a range of matches in order of match, so that
        # each page would sort all of them by id. If the range is wide, a scan by id
        # finds enough boxes sooner.
        after = at.box_id if at != START else self._before_first()
        rows = (
            select(Decision.box_id)
            .where(
                Decision.box_id > after,
                Decision.box_id <= after + WINDOW,
                *self._wanted.conditions_by_id(),
            )
            .order_by(Decision.box_id)
            .limit(asked.limit)
        )
        return [
            Position(asked.tier, float(box_id), _NO_STREAM, box_id)
            for box_id in self._session.scalars(rows)
        ]

    def _before_first(self) -> int:
        class_ids = self._streams.contents.class_ids
        span = BoxProbes(self._session).span(self._wanted.dataset_id, class_ids)
        return span[0] - 1 if span else 0

    def _merged(self, asked: _TierRequest, at: Position) -> list[Position]:
        plan = _plan(asked, is_first=at == START)
        parameters: dict[str, float | int] = {"score": at.score}
        for number, stream in enumerate(plan.streams):
            parameters |= stream.parameters(number, at)
        signs = [stream.sign for stream in plan.streams]
        rows: list[tuple[float, int, int]] = []
        for query in plan.queries:
            rows += [
                (float(score), number, box_id)
                for score, number, box_id in self._session.execute(query, parameters)
                if score is not None
            ]
            rows.sort(key=lambda row: (row[0], row[1], row[2] * signs[row[1]]))
            del rows[asked.limit :]
        return [Position(asked.tier, *row) for row in rows]


class _TierRequest(NamedTuple):
    """A part of a page: up to `limit` boxes of one tier of an order."""

    streams: BoxOrder
    order: str
    tier: int
    limit: int


_Query: TypeAlias = (
    "Select[float | None, int, int] | CompoundSelect[float | None, int, int]"
)

STREAMS_TOGETHER: Final = 96
"""How many streams one statement reads: enough for all of some thirty classes. The
time to compile a statement grows faster than its length, and SQLite allows 500."""


class _Plan(NamedTuple):
    """The statements that read part of a page, and the streams that they read."""

    queries: Sequence[_Query]
    streams: Sequence[Stream]


def _plan(asked: _TierRequest, *, is_first: bool) -> _Plan:
    # Building a statement of some sixty streams takes several times as long as
    # executing it. Plans for many classes would take up too much memory.
    if len(asked.streams.contents.kinds) > STREAMS_TOGETHER:
        return _new_plan(asked, is_first=is_first)
    return _known_plan(asked, is_first=is_first)


def _new_plan(asked: _TierRequest, *, is_first: bool) -> _Plan:
    streams: Sequence[Stream] = TIERS[asked.order][asked.tier](asked.streams)
    rows = [
        stream.rows(number, asked.limit, is_first=is_first)
        for number, stream in enumerate(streams)
    ]
    queries = [
        union_all(*together) if len(together) > 1 else together[0]
        for together in chunks(rows, most=STREAMS_TOGETHER)
    ]
    return _Plan(queries, streams)


_known_plan: Final = lru_cache(maxsize=128)(_new_plan)


def encode(position: Position) -> str:
    """A position as a cursor."""
    text = json.dumps(list(position), separators=(",", ":"))
    return base64.urlsafe_b64encode(text.encode()).decode().rstrip("=")


def decode(cursor: str) -> Position:
    """The position in a cursor; BadCursor for a text that `encode` cannot return."""
    try:
        padded = cursor + "=" * (-len(cursor) % 4)
        tier, score, stream, box_id = json.loads(base64.urlsafe_b64decode(padded))
        position = Position(int(tier), float(score), int(stream), int(box_id))
        if not all(-MAX_ID <= number <= MAX_ID for number in position):
            raise ValueError(position)
        return position
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        raise BadCursor(cursor) from error
