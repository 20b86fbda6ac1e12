"""Failures of a database that pass by themselves: work that met one is done again."""

from __future__ import annotations

from typing import Final

from sqlalchemy import exc as sql

_TOO_MANY_CONNECTIONS: Final = "53300"
_TOLD_TO_END: Final = "57014"
"""A statement was ended for what it is: it would be again."""
_NO_ROOM: Final = "53"
_BUSY: Final = ("locked", "busy")


def is_passing(exc: Exception) -> bool:
    """Whether the database was away, or somebody else has written for too long.

    False for a disk or a memory that is full: that does not end by waiting.
    """
    if isinstance(exc, sql.TimeoutError):
        return True
    if not isinstance(exc, (sql.OperationalError, sql.InterfaceError)):
        return False
    if "sqlite" in type(exc.orig).__module__:
        return any(word in str(exc.orig).lower() for word in _BUSY)
    # None where a connection was not made, or broke off without a word.
    state: str = getattr(exc.orig, "sqlstate", None) or ""
    if state == _TOO_MANY_CONNECTIONS:
        return True
    return state != _TOLD_TO_END and not state.startswith(_NO_ROOM)


def in_a_line(exc: Exception) -> str:
    """What to say of it in a log: no statement, and nothing that people wrote."""
    return str(exc).partition("\n")[0]
