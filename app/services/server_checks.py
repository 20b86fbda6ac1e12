"""What `unghost doctor` asks a PostgreSQL server."""

from __future__ import annotations

from collections.abc import Iterator

from sqlalchemy import Engine

from app.db.server_inspection import (
    broken_keys,
    not_durable,
    silence_of,
    version_of,
)
from app.services.findings import MOST_EXAMPLES, Finding, Severity


def is_answering(engine: Engine) -> Finding:
    """Whether the database can be reached at all."""
    reason = silence_of(engine)
    if not reason:
        found = f"PostgreSQL {version_of(engine)} answers"
        return Finding("database", Severity.OK, found)
    return Finding(
        "database",
        Severity.ERROR,
        f"it does not answer: {reason}",
        "start PostgreSQL, make the database, or mend UNGHOST_DATABASE_URL; nothing "
        "is served until then",
    )


def server_findings(engine: Engine) -> Iterator[Finding]:
    """What is wrong with a database that answers and is at a known schema."""
    yield _keys(broken_keys(engine))
    yield _durability(not_durable(engine))


def _keys(problems: list[str]) -> Finding:
    if not problems:
        return Finding("keys", Severity.OK, "every row has the rows it belongs to")
    return Finding(
        "keys",
        Severity.ERROR,
        f"they do not hold: {problems[0]}",
        "restore the last dump into a new database, with `pg_restore "
        "--exit-on-error`, and the files beside it",
        len(problems),
        tuple(problems[:MOST_EXAMPLES]),
    )


def _durability(off: list[str]) -> Finding:
    if not off:
        return Finding("durability", Severity.OK, "what was answered is on the disk")
    return Finding(
        "durability",
        Severity.WARNING,
        f"a power cut may take what was answered: {', '.join(off)}",
        "turn it on in postgresql.conf, or with ALTER SYSTEM, and reload the server",
        len(off),
        tuple(off),
    )
