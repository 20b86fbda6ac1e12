"""Pages of boxes in the orders that people review in, each read off an index."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Final, NamedTuple

from sqlalchemy import CompoundSelect, Select, select, union_all
from sqlalchemy.orm import Session

from app.db.tables import Decision
from app.repositories.box_filter import BoxFilter
from app.repositories.box_orders import TIERS, BoxOrder, Present
from app.repositories.box_probes import BoxProbes
from app.repositories.box_streams import START, Position, Stream, decode, encode

ORDERS: Final = tuple(TIERS)
WINDOW: Final = 1 << 14
"""Ids that are looked through in their order before all boxes of a range are sorted."""

_NO_STREAM: Final = 1 << 30
"""Comes after all streams: none of them has another box of the same id."""


class BoxPages:
    """Keyset pages over current decisions."""

    def __init__(self, session: Session, wanted: BoxFilter, present: Present) -> None:
        self._session = session
        self._wanted = wanted
        self._order_of = BoxOrder(wanted, present)

    def page(self, order: str, cursor: str, limit: int) -> tuple[list[int], str | None]:
        """Ids of the next boxes, and the cursor of the page after them."""
        at = decode(cursor) if cursor else START
        found: list[Position] = []
        for tier in range(at.tier, len(TIERS[order])):
            start = at if tier == at.tier else START
            asked = _Asked(self._order_of, order, tier, limit + 1 - len(found))
            found += self._next_of(asked, start)
            if len(found) > limit:
                break
        more = len(found) > limit
        found = found[:limit]
        cursor_after = encode(found[-1]) if more and found else None
        return [position.box_id for position in found], cursor_after

    def _next_of(self, asked: _Asked, at: Position) -> list[Position]:
        if asked.order == "id" and self._wanted.is_found_by_match:
            found = self._in_window(asked, at)
            if len(found) == asked.limit:
                return found
        return self._merged(asked, at)

    def _in_window(self, asked: _Asked, at: Position) -> list[Position]:
        # An index finds the boxes of a range in the order of their matches: all would
        # be sorted for a page. Of a wide range, a page's worth is soon passed by.
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
        present = self._order_of.present.class_ids
        span = BoxProbes(self._session).span(self._wanted.dataset_id, present)
        return span[0] - 1 if span else 0

    def _merged(self, asked: _Asked, at: Position) -> list[Position]:
        plan = _first_page(asked) if at == START else _page(asked, at)
        if plan.query is None:
            return []
        rows = [
            (float(row[0]), int(row[1]), int(row[2]))
            for row in self._session.execute(plan.query)
        ]
        rows.sort(key=lambda row: (row[0], row[1], row[2] * plan.signs[row[1]]))
        return [Position(asked.tier, *row) for row in rows[: asked.limit]]


class _Asked(NamedTuple):
    """A part of a page: so many boxes of one tier."""

    order_of: BoxOrder
    order: str
    tier: int
    limit: int


class _Plan(NamedTuple):
    """The statement that reads it, if there is anything, and each stream's sign."""

    query: Select[Any] | CompoundSelect[Any] | None
    signs: Sequence[int]


def _page(asked: _Asked, at: Position) -> _Plan:
    streams: Sequence[Stream] = TIERS[asked.order][asked.tier](asked.order_of)
    parts = [
        stream.rows(number, at, asked.limit) for number, stream in enumerate(streams)
    ]
    signs = [stream.sign for stream in streams]
    if not parts:
        return _Plan(None, signs)
    return _Plan(union_all(*parts) if len(parts) > 1 else parts[0], signs)


@lru_cache(maxsize=128)
def _first_page(asked: _Asked) -> _Plan:
    # Kept, as a queue begins anew for every answer: putting together the statement of
    # some sixty streams takes several times as long as running it.
    return _page(asked, START)
