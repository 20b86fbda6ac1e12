"""Pages of boxes in the orders of lists and the queue, read from indexes.

Doubt is a column (`filter_core.decisions.doubt`). The boxes to ask about have an index
that is in its order, for each kind of answer; those of the other bins follow, by id. If
a filter selects few of the boxes to ask about, these are found by other indexes, and
sorted.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Final, NamedTuple, TypeAlias

from sqlalchemy import (
    ColumnElement,
    CompoundSelect,
    Float,
    Select,
    SQLColumnExpression,
    and_,
    bindparam,
    or_,
    select,
    union_all,
)
from sqlalchemy.orm import Session

from app.boxes.filter import BoxFilter, BoxProbes, TallyKey
from app.db.base import MAX_ID, Key
from app.db.bulk import chunks
from app.db.tables import Decision
from app.errors import BadCursor
from app.verdicts import REVIEW_STATES, in_bin
from filter_core.decisions.doubt import Bin

RARE: Final = 100
"""If fewer than one in so many boxes to ask about is selected, it is faster to sort
those that are selected than to read all in the order of doubt."""

_EPSILON: Final = 1e-9


@dataclass(frozen=True)
class BoxOrder:
    """Builds the streams of each tier, for one filter.

    An order consists of tiers: all boxes of a tier come before those of the next one.
    The fields after `box_filter` are what it may select: streams for anything else
    would be empty. `is_rare`: it selects so few of the boxes to ask about, such as
    toss-ups, that a page of them would be searched for among thousands of others.
    """

    box_filter: BoxFilter
    reasons: tuple[int, ...]
    class_ids: frozenset[int]
    bins: frozenset[Bin]
    is_rare: bool

    @classmethod
    def of(
        cls,
        box_filter: BoxFilter,
        tallies: Mapping[TallyKey, int],
        most: int,
        rare: int,
    ) -> BoxOrder:
        """That of a filter and its dataset's tallies; it selects at most `most`."""
        selected = {
            key: boxes for key, boxes in tallies.items() if box_filter.selects(key)
        }
        to_ask = sum(boxes for key, boxes in tallies.items() if key.bin == Bin.ASK)
        to_ask_selected = sum(n for key, n in selected.items() if key.bin == Bin.ASK)
        return cls(
            box_filter,
            tuple(sorted({key.reason for key in tallies})),
            frozenset(key.class_id for key in tallies),
            frozenset(Bin(key.bin) for key in selected),
            box_filter.toss_up is True
            or box_filter.has_places
            or min(to_ask_selected, most) * rare < to_ask,
        )

    def by_id(self, *conditions: ColumnElement[bool]) -> list[Stream]:
        """The boxes that meet these conditions too, by id."""
        # One stream per reason: "reason in (...) order by id" would sort all rows.
        # Without reasons, one per class, since no index has the dataset and id alone.
        # Answered boxes are few, and have an index of their own.
        box_filter = self.box_filter
        if box_filter.only_answered:
            parts = [box_filter.conditions()]
        elif not box_filter.reasons:
            parts = self._by_class()
        else:
            # Without "reason in (...)": a database may prefer it to "reason = ...".
            every = replace(box_filter, reasons=()).conditions()
            reasons = [r for r in self.reasons if r in box_filter.reasons]
            parts = [[*every, Decision.reason == reason] for reason in reasons]
        return [Stream(Decision.box_id, [*part, *conditions]) for part in parts]

    def by_match(self, sign: int) -> list[Stream]:
        """Boxes with a match, by match: ascending if `sign` is 1, descending if -1."""
        column, has_match = Decision.match_percent, Decision.match_percent.is_not(None)
        if self.box_filter.only_answered:
            every = [*self.box_filter.conditions(), has_match]
            return [Stream(self._column(column), every, sign=sign)]
        return [Stream(column, [*of, has_match], sign=sign) for of in self._by_class()]

    def unmatched(self) -> list[Stream]:
        """Boxes without a match, by id."""
        return self.by_id(Decision.match_percent.is_(None))

    def by_crowding(self) -> list[Stream]:
        """The most crowded first."""
        column = self._column(Decision.crowding)
        return [Stream(column, self.box_filter.conditions(), sign=-1)]

    def by_doubt(self, bin_: Bin) -> list[Stream]:
        """The boxes of a bin, the most doubtful first."""
        if bin_ not in self.bins:
            return []
        every = [*self.box_filter.conditions(), in_bin(bin_)]
        if bin_ is not Bin.ASK:  # all of its boxes have the same doubt
            return self.by_id(in_bin(bin_))
        if self.is_rare:
            # "+ 0" prevents the use of the index on this column.
            return [Stream(Decision.doubt + 0, every, sign=-1)]
        states = (
            REVIEW_STATES[self.box_filter.review].answers
            if self.box_filter.review
            else ()
        )
        return [
            Stream(Decision.doubt, [*every, answered(state)], -1, Decision.review)
            for state in states or ("", "keep", "reject", "unsure")
        ]

    def _by_class(self) -> list[list[ColumnElement[bool]]]:
        """The conditions of the boxes of each class."""
        # A condition on margins compares only with the thresholds of that class, and
        # an index reads the range of matches around all of them.
        margin, class_ids = self.box_filter.margin_max, self.box_filter.class_ids
        parts = []
        for each in self.box_filter.thresholds:
            key = each.class_id
            is_asked = class_ids is None or key in class_ids
            if is_asked and key in self.class_ids:
                part = replace(self.box_filter, thresholds=(each,)).conditions()
                part.append(Decision.class_id == key)
                if margin is not None:
                    limits = [side.threshold for side in each.sides]
                    low, high = min(limits, default=0.0), max(limits, default=0.0)
                    reach = (low - margin, high + margin)
                    part.append(Decision.match_percent.between(*reach))
                parts.append(part)
        return parts

    def _column(
        self, column: SQLColumnExpression[float | None]
    ) -> SQLColumnExpression[float | None]:
        # "+ 0" prevents the use of an index on this column: answered boxes are few, and
        # the index on answers finds them.
        return column + 0 if self.box_filter.only_answered else column


def answered(state: str) -> ColumnElement[bool]:
    """Condition: the latest answer is this one; empty: there is none."""
    return Decision.review == state if state else Decision.review.is_(None)


class Position(NamedTuple):
    """Where a page ended: its last box, in which tier of the order, with its score.

    A cursor encodes these numbers. The score is the sort key of the tier's streams.
    """

    tier: int
    score: float
    box_id: int


@dataclass(frozen=True)
class Stream:
    """Boxes in the order of an index: by ``column * sign``, their score, and by id.

    All streams of a tier have the same sign. `alike` is a column before it in the index
    that all boxes of the stream share.
    """

    column: SQLColumnExpression[float | None]
    conditions: Sequence[ColumnElement[bool]]
    sign: int = 1
    alike: SQLColumnExpression[str | None] | None = None

    def beyond(self) -> list[ColumnElement[bool]]:
        """Conditions for the rows after a position, which `parameters` has.

        The index can use the first.
        """
        column, bound = self.column, bindparam("bound", type_=Float)
        reached, last = bindparam("reached", type_=Float), bindparam("last", type_=Key)
        if self.sign > 0:
            in_reach, further = column >= bound, column > reached
            later = Decision.box_id > last
        else:
            in_reach, further = column <= bound, column < reached
            later = Decision.box_id < last
        return [in_reach, or_(further, and_(column == reached, later))]

    def rows(self, limit: int, *, is_first: bool) -> Select[float | None, int]:
        """The first rows of this stream alone, or the next."""
        # PostgreSQL reads an index in order only if all its columns are named, also one
        # that is NULL in all rows.
        named = (self.column, Decision.box_id)
        columns = named if self.alike is None else (self.alike, *named)
        inner = (
            select(self.column.label("number"), Decision.box_id.label("box_id"))
            .where(*self.conditions, *([] if is_first else self.beyond()))
            .order_by(*(each if self.sign > 0 else each.desc() for each in columns))
            .limit(limit)
            .subquery()
        )
        return select(inner.c.number, inner.c.box_id)


Tier = Callable[[BoxOrder], list[Stream]]

TIERS: Final[Mapping[str, Sequence[Tier]]] = {
    "id": (BoxOrder.by_id,),
    "doubt": tuple(partial(BoxOrder.by_doubt, bin_=bin_) for bin_ in Bin),
    "match_percent": (lambda order: order.by_match(1), BoxOrder.unmatched),
    "-match_percent": (lambda order: order.by_match(-1), BoxOrder.unmatched),
    "crowding": (BoxOrder.by_crowding,),
}
"""The tiers of each order; a tier is built only when those before it have ended."""

ORDERS: Final = tuple(TIERS)
WINDOW: Final = 1 << 14
"""How many ids are scanned in order before all boxes of a range are sorted instead."""

START: Final = Position(0, float("-inf"), 0)


class BoxPages:
    """Keyset pagination of current decisions: pages begin where the last one ended."""

    def __init__(
        self,
        session: Session,
        box_filter: BoxFilter,
        tallies: Mapping[TallyKey, int],
        most: int = MAX_ID,
        rare: int = RARE,
    ) -> None:
        self._session = session
        self._filter = box_filter
        self._streams = BoxOrder.of(box_filter, tallies, most, rare)

    def page(
        self, order: str, cursor: str | None, limit: int
    ) -> tuple[list[int], str | None]:
        """Ids of the next boxes, and the cursor of the page after them."""
        at = decode(cursor) if cursor else START
        positions: list[Position] = []
        for tier in range(at.tier, len(TIERS[order])):
            start = at if tier == at.tier else START
            positions += self._next_of(order, tier, limit + 1 - len(positions), start)
            if len(positions) > limit:
                break
        more = len(positions) > limit
        positions = positions[:limit]
        cursor_after = encode(positions[-1]) if more and positions else None
        return [position.box_id for position in positions], cursor_after

    def _next_of(
        self, order: str, tier: int, limit: int, at: Position
    ) -> list[Position]:
        """Up to `limit` boxes of one tier after a position."""
        if order == "id" and self._filter.is_found_by_match:
            # The index returns the boxes of a range of matches in order of match, so
            # that each page would sort all of them by id. If the range is wide, a scan
            # by id finds enough boxes sooner.
            after = at.box_id
            if at == START:
                class_ids = self._streams.class_ids
                span = BoxProbes(self._session).span(self._filter.dataset_id, class_ids)
                after = span[0] - 1 if span else 0
            window = (Decision.box_id > after, Decision.box_id <= after + WINDOW)
            by_id = (
                select(Decision.box_id)
                .where(*window, *self._filter.conditions_by_id())
                .order_by(Decision.box_id)
                .limit(limit)
            )
            ids = self._session.scalars(by_id)
            positions = [Position(tier, float(box_id), box_id) for box_id in ids]
            if len(positions) == limit:
                return positions
        # Building a statement of a stream for each class takes several times as long as
        # executing it. Plans for many classes would take up too much memory.
        many = len(self._streams.class_ids) > STREAMS_TOGETHER
        plan = _new_plan if many else _cached_plan
        queries, sign = plan(self._streams, order, tier, limit, is_first=at == START)
        # The bound leaves room for a number that a database rounds.
        bound = sign * (at.score - _EPSILON)
        after_last = {"bound": bound, "reached": sign * at.score, "last": at.box_id}
        rows: list[tuple[float, int]] = []
        for query in queries:
            rows += [
                (sign * float(number), sign * box_id)
                for number, box_id in self._session.execute(query, after_last)
                if number is not None
            ]
            rows.sort()
            del rows[limit:]
        return [Position(tier, score, sign * place) for score, place in rows]


_Query: TypeAlias = "Select[float | None, int] | CompoundSelect[float | None, int]"

STREAMS_TOGETHER: Final = 96
"""How many streams, of a class each, one statement reads. The
time to compile a statement grows faster than its length, and SQLite allows 500."""


def _new_plan(
    order: BoxOrder, name: str, tier: int, limit: int, *, is_first: bool
) -> tuple[Sequence[_Query], int]:
    """The statements that read part of a page, and the sign of their streams."""
    streams: Sequence[Stream] = TIERS[name][tier](order)
    rows = [stream.rows(limit, is_first=is_first) for stream in streams]
    queries = [
        union_all(*together) if len(together) > 1 else together[0]
        for together in chunks(rows, most=STREAMS_TOGETHER)
    ]
    return queries, streams[0].sign if streams else 1


_cached_plan: Final = lru_cache(maxsize=128)(_new_plan)


def encode(position: Position) -> str:
    """A position as a cursor."""
    text = json.dumps(list(position), separators=(",", ":"))
    return base64.urlsafe_b64encode(text.encode()).decode().rstrip("=")


def decode(cursor: str) -> Position:
    """The position in a cursor; BadCursor for a text that `encode` cannot return."""
    try:
        padded = cursor + "=" * (-len(cursor) % 4)
        tier, score, box_id = json.loads(base64.urlsafe_b64decode(padded))
        position = Position(int(tier), float(score), int(box_id))
        if not all(-MAX_ID <= number <= MAX_ID for number in position):
            raise ValueError(position)
        return position
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        raise BadCursor(cursor) from error
