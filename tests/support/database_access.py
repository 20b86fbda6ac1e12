"""Records which modules of the service write to its database, and where.

Listeners are added to SQLAlchemy once, when this module is imported: its lists of
listeners must not change while a service is running.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from traceback import walk_stack
from typing import Any

from sqlalchemy import URL, Engine, event
from sqlalchemy.orm import Session, object_session
from sqlalchemy.pool import Pool

from app.db.base import Base
from app.db.engine import Database

_WRITES = re.compile(r'(?:INSERT INTO|UPDATE|DELETE FROM) "?(\w+)')
_WRITING: ContextVar[bool] = ContextVar("writing", default=False)
"""Whether a write transaction is open in this context.

A context is one call of a route in its thread, or a thread of the service.
"""


@dataclass
class DatabaseAccess:
    """What the modules of `app` did with the database."""

    writes: set[tuple[str, str]] = field(default_factory=set)
    """Pairs of a module and a table in which it inserted, changed or deleted rows."""
    nested_transactions: set[str] = field(default_factory=set)
    """Modules that began a second transaction while a write transaction was open."""


_watched: dict[URL, DatabaseAccess] = {}


@contextmanager
def record_access(database: Database) -> Iterator[DatabaseAccess]:
    """Record what all threads do with this database until the block ends."""
    acts = _watched[database.engine.url] = DatabaseAccess()
    try:
        yield acts
    finally:
        del _watched[database.engine.url]


@event.listens_for(Engine, "begin")
def _begun(connection: Any) -> None:
    acts = _watched.get(connection.engine.url)
    if acts and _WRITING.get():
        acts.nested_transactions.add(_caller())
    if connection.get_execution_options().get("writes", False):
        _WRITING.set(True)
        connection.connection.record_info["watched"] = True


@event.listens_for(Pool, "checkin")
def _given_back(_connection: Any, record: Any) -> None:
    if (record.record_info or {}).pop("watched", False):
        _WRITING.set(False)


@event.listens_for(Engine, "before_cursor_execute")
def _executed(connection: Any, _cursor: Any, statement: str, *_rest: Any) -> None:
    acts, written = _watched.get(connection.engine.url), _WRITES.search(statement)
    # Rows that a flush writes were recorded when they were added or changed.
    if acts and written and "sqlalchemy.orm.unitofwork" not in _callers():
        acts.writes.add((_caller(), written[1]))


@event.listens_for(Session, "transient_to_pending")
def _added(session: Session, row: Any) -> None:
    if acts := _watched.get(session.get_bind().engine.url):
        acts.writes.add((_caller(), row.__tablename__))


def _changed(row: Any, *_values: Any) -> None:
    session = object_session(row)
    if session is not None:
        _added(session, row)


for _mapper in Base.registry.mappers:
    for _column in _mapper.column_attrs:
        event.listen(getattr(_mapper.class_, _column.key), "set", _changed)


def _callers() -> list[str]:
    """Modules in the call stack, the innermost first."""
    return [str(frame.f_globals.get("__name__")) for frame, _ in walk_stack(None)]


def _caller() -> str:
    """The innermost module of `app` in the call stack that is not in `app.db`."""
    modules = (name for name in _callers() if name.startswith("app."))
    return next((name for name in modules if not name.startswith("app.db.")), "tests")
