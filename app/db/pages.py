"""Pages of lists: what their cursors contain, and rows with the newest first."""

from __future__ import annotations

import unicodedata
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from sqlalchemy import Select, SQLColumnExpression, select
from sqlalchemy.orm import Session

from app.db.base import MAX_ID
from app.db.tables import ConfigVersion, Export, Problem, Run
from app.errors import BadCursor

if TYPE_CHECKING:
    from sqlalchemy.util.typing import TypeVarTuple, Unpack

    _Columns = TypeVarTuple("_Columns")

Row = TypeVar("Row", ConfigVersion, Export, Problem, Run)


def id_of_cursor(cursor: str) -> int:
    """The id in a cursor of a list by id; BadCursor if it is not an id."""
    if not cursor.isascii() or not cursor.isdecimal() or not 0 < int(cursor) <= MAX_ID:
        raise BadCursor(cursor)
    return int(cursor)


def name_of_cursor(cursor: str) -> str:
    """The name in a cursor of a list by name; BadCursor if it cannot be a name."""
    if any(unicodedata.category(character).startswith("C") for character in cursor):
        raise BadCursor(cursor)
    return cursor


def cursor_after(number: float, row_id: int) -> str:
    """The cursor of a list in the order of a number, and then of the id."""
    return f"{number!r}~{row_id}"


def number_and_id_of_cursor(cursor: str) -> tuple[float, int]:
    """The number and the id that `cursor_after` was given; BadCursor otherwise."""
    number, _, row_id = cursor.partition("~")
    try:
        place = float(number), id_of_cursor(row_id)
    except (ValueError, BadCursor):
        raise BadCursor(cursor) from None
    if not place[0] >= 0:
        raise BadCursor(cursor)
    return place


@dataclass(frozen=True)
class NewestPage:
    """A page of rows, newest first: the rows before an id (None: the first page)."""

    before_id: int | None
    limit: int

    def of(
        self, rows: Select[Unpack[_Columns]], key: SQLColumnExpression[int]
    ) -> Select[Unpack[_Columns]]:
        """Its rows among these, and one more if there is a next page."""
        if self.before_id is not None:
            rows = rows.where(key < self.before_id)
        return rows.order_by(key.desc()).limit(self.limit + 1)


def newest(
    session: Session, table: type[Row], dataset_id: int, page: NewestPage
) -> list[Row]:
    """The rows of a page, and one more if there is a next page."""
    rows = select(table).where(table.dataset_id == dataset_id)
    return list(session.scalars(page.of(rows, table.id)))
