"""What happened to a dataset, newest first, a page at a time."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

from sqlalchemy import select
from sqlalchemy.orm import Session

from app.db.tables import ConfigVersion, Export, Problem, Run

Row = TypeVar("Row", ConfigVersion, Export, Problem, Run)


class NewestPage(NamedTuple):
    """The rows that came before one (or the newest), and how many of them."""

    before_id: int | None
    limit: int


def newest(
    session: Session, table: type[Row], dataset_id: int, page: NewestPage
) -> list[Row]:
    """A page, and one row more if there is one: so one knows that there is another."""
    rows = select(table).where(table.dataset_id == dataset_id)
    if page.before_id is not None:
        rows = rows.where(table.id < page.before_id)
    rows = rows.order_by(table.id.desc()).limit(page.limit + 1)
    return list(session.scalars(rows))
