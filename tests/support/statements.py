"""The SQL that is run, as SQLAlchemy hands it to the driver."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from sqlalchemy import Connection, Engine, event

Statement = tuple[str, Any]
"""Its text and its parameters, those of the first row where there are many."""


@contextmanager
def statements_of(engine: Engine | Connection) -> Iterator[list[Statement]]:
    """What is run until the block ends, by whichever thread."""
    found: list[Statement] = []

    def note(_connection, _cursor, statement, parameters, *_rest):
        one = parameters[0] if isinstance(parameters, list) else parameters
        found.append((statement, one))

    event.listen(engine, "before_cursor_execute", note)
    try:
        yield found
    finally:
        event.remove(engine, "before_cursor_execute", note)
