"""Boxes in the order of an index, and the places at which a page of them can end."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from sqlalchemy import (
    ColumnElement,
    Select,
    SQLColumnExpression,
    and_,
    literal,
    or_,
    select,
)

from app.db.tables import Decision
from app.errors import BadRequest

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


def encode(position: Position) -> str:
    """The cursor that stands for a position."""
    text = json.dumps(list(position), separators=(",", ":"))
    return base64.urlsafe_b64encode(text.encode()).decode().rstrip("=")


def decode(cursor: str) -> Position:
    """The position of a cursor; BadRequest if it is none of ours."""
    try:
        padded = cursor + "=" * (-len(cursor) % 4)
        tier, score, stream, box_id = json.loads(base64.urlsafe_b64decode(padded))
        position = Position(int(tier), float(score), int(stream), int(box_id))
        if not all(-_MAX_ID <= number <= _MAX_ID for number in position):
            raise ValueError(position)
        return position
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        raise BadRequest(f"cursor {cursor!r} is not one of ours") from error
