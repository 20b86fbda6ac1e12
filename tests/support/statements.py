"""The SQL that is run, as SQLAlchemy hands it to the driver: noted, or interrupted."""

from __future__ import annotations

from collections.abc import Callable, Iterator
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


@contextmanager
def interrupted_at(
    engine: Engine, words: str, act: Callable[[], object], *, after: bool = False
) -> Iterator[None]:
    """Call `act` once: at the first statement with these words, before or after it.

    It is called in the thread that runs the statement, which goes on behind it.
    """
    waiting = [act]

    def call(_connection, _cursor, statement, *_rest):
        if waiting and words in statement:
            waiting.pop()()

    when = "after_cursor_execute" if after else "before_cursor_execute"
    event.listen(engine, when, call)
    try:
        yield
    finally:
        event.remove(engine, when, call)
    assert not waiting, f"no statement with {words!r}"
