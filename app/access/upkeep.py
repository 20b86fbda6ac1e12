"""Writes once a minute when tokens were last used, so that no GET has to write a row.

Wrong secrets are logged, in one line per minute, and not stored, so that nobody without
a token can fill the database.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Final

from app.access.gate import LastUses, WrongSecrets
from app.access.queries import Tokens
from app.background import Task, attempt, repeating
from app.context import ServiceContext
from app.logs import server_log

EVERY_S: Final = 60.0


@contextmanager
def keeping_tokens(context: ServiceContext) -> Iterator[None]:
    """Call `write_upkeep` once a minute until the block ends, and then once more."""
    purpose = "note the use of tokens"
    task = Task("token upkeep", purpose, partial(write_upkeep, context), EVERY_S)
    try:
        with repeating(context, task):
            yield
    finally:
        attempt(context, task)


def write_upkeep(context: ServiceContext) -> None:
    """Write the times of last use, and log wrong secrets."""
    wrong = context.one(WrongSecrets).take()
    if wrong:
        server_log.warning("requests refused within a minute: %s", wrong)
    uses = context.one(LastUses).take()
    if uses:
        try:
            with context.database.write() as session:
                for token_id, at in sorted(uses.items()):
                    Tokens(session).note_use(token_id, at)
        except BaseException:
            context.one(LastUses).put_back(uses)
            raise
