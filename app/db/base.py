"""Shared by all tables and queries: keys, UTC times, JSON text, names, the session."""

from __future__ import annotations

import json
from datetime import datetime, timezone
from typing import Final, Literal, TypeVar

from sqlalchemy import (
    BigInteger,
    DateTime,
    ForeignKey,
    Integer,
    MetaData,
    Text,
    TypeDecorator,
)
from sqlalchemy.engine import Dialect
from sqlalchemy.orm import DeclarativeBase, MappedColumn, Session, mapped_column

from app.errors import NotFound
from unghost.wire.model import ResponseModel

_Id = TypeVar("_Id", bound="int | None")
_Row = TypeVar("_Row")
_Response = TypeVar("_Response", bound=ResponseModel)

Key = BigInteger().with_variant(Integer, "sqlite")
"""64-bit keys; SQLite assigns ids only to a column of the type INTEGER."""


MAX_ID: Final = 2**63 - 1
"""The largest key."""
MAX_REVISION: Final = 2**31 - 1
"""The largest revision of a box."""


def filled(key: int | None) -> int:
    """A key that is null only in the transaction that inserts its row.

    Raises RuntimeError: it is null: the row was never completed, which is a fault of
    the program.
    """
    if key is None:
        raise RuntimeError("a key is null in a row that should be complete")
    return key


class UtcDateTime(TypeDecorator[datetime]):
    """A time with the zone UTC; SQLite stores times without a zone."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(
        self, value: datetime | None, dialect: Dialect
    ) -> datetime | None:
        """The time to store, in UTC."""
        return value.astimezone(timezone.utc) if value else None

    def process_result_value(
        self, value: datetime | None, dialect: Dialect
    ) -> datetime | None:
        """The stored time in UTC: PostgreSQL returns it in the zone of the session."""
        if value is None:
            return None
        if value.tzinfo is None:
            return value.replace(tzinfo=timezone.utc)
        return value.astimezone(timezone.utc)


class JsonText(TypeDecorator[object]):
    """JSON stored as text: readable in any shell, and the same on every database."""

    impl = Text
    cache_ok = True

    def process_bind_param(self, value: object, dialect: Dialect) -> str | None:
        """The text to store, without spaces."""
        if value is None:
            return None
        return json.dumps(value, ensure_ascii=False, separators=(",", ":"))

    def process_result_value(self, value: str | None, dialect: Dialect) -> object:
        """The value of a stored text."""
        return None if value is None else json.loads(value)


class Base(DeclarativeBase):
    """Declarative base; constraint names follow one convention."""

    metadata = MetaData(
        naming_convention={
            "ix": "ix_%(table_name)s_%(column_0_N_name)s",
            "uq": "uq_%(table_name)s_%(column_0_N_name)s",
            "ck": "ck_%(table_name)s_%(constraint_name)s",
            "fk": "fk_%(table_name)s_%(column_0_N_name)s",
            "pk": "pk_%(table_name)s",
        }
    )


def cascading(
    column: str,
    *,
    index: bool | None = None,
    primary_key: bool = False,
    autoincrement: Literal["auto"] | bool = "auto",
) -> MappedColumn[_Id]:
    """A column of another table's keys, with whose rows those of this one go."""
    return mapped_column(
        Key,
        ForeignKey(column, ondelete="CASCADE"),
        index=index,
        primary_key=primary_key,
        autoincrement=autoincrement,
    )


class Repository:
    """SQL about some rows, on one session."""

    def __init__(self, session: Session) -> None:
        self._session = session


def insert_row(session: Session, row: _Row) -> _Row:
    """Insert a row, which has its id afterwards."""
    session.add(row)
    session.flush()
    return row


def response_of(model: type[_Response], row: Base, **more: object) -> _Response:
    """A row as responses show it: columns that are fields of the model, and more."""
    same = model.model_fields.keys() - more.keys()
    return model.model_validate({name: getattr(row, name) for name in same} | more)


def existing(row: _Row | None, kind: str, key: object) -> _Row:
    """The row that was looked up; NotFound if there is none."""
    if row is None:
        raise NotFound(kind, key)
    return row


def utc_now() -> datetime:
    """The time now, with the zone UTC."""
    return datetime.now(timezone.utc)


def rfc3339(at: datetime) -> str:
    """A time with a zone as text: UTC, ending in ``Z``."""
    return at.astimezone(timezone.utc).isoformat().removesuffix("+00:00") + "Z"
