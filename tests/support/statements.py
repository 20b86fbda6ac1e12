"""Records the SQL statements that are run, or calls a function at one of them."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from sqlalchemy import Connection, Engine, event

Statement = tuple[str, Any]
"""The text and the parameters of a statement (of many rows, those of the first)."""


@contextmanager
def statements_of(engine: Engine | Connection) -> Iterator[list[Statement]]:
    """Collect the statements that any thread runs until the block ends."""
    statements: list[Statement] = []

    def note(_connection, _cursor, statement, parameters, *_rest):
        row = parameters[0] if isinstance(parameters, list) else parameters
        statements.append((statement, row))

    event.listen(engine, "before_cursor_execute", note)
    try:
        yield statements
    finally:
        event.remove(engine, "before_cursor_execute", note)


@contextmanager
def interrupted_at(
    engine: Engine, words: str, act: Callable[[], object], *, after: bool = False
) -> Iterator[None]:
    """Call `act` once, before or after the first statement that contains `words`.

    It is called in the thread that runs the statement, which waits for it. Fails if no
    such statement is run.
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
