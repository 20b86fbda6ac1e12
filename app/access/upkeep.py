"""Writes once a minute when tokens were last used, so that no GET has to write a row.

The first token is renewed when it expires soon. Wrong secrets are logged, in one line
per minute, and not stored, so that nobody without a token can fill the database.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from functools import partial
from typing import Final

from app.access.first_token import is_first_token_due, renew_first_token
from app.access.gate import LastUses, WrongSecrets
from app.access.queries import Tokens
from app.context import ServiceContext
from app.db.base import utc_now
from app.logs import server_log
from app.maintenance.background import Task, attempt, repeating

EVERY_S: Final = 60.0


@contextmanager
def keeping_tokens(context: ServiceContext) -> Iterator[None]:
    """Call `write_upkeep` once a minute until the block ends, and then once more."""
    purpose = "note the use of tokens or renew the token file"
    task = Task("token upkeep", purpose, partial(write_upkeep, context), EVERY_S)
    try:
        with repeating(context, task):
            yield
    finally:
        attempt(context, task)


def write_upkeep(context: ServiceContext) -> None:
    """Write the times of last use, log wrong secrets, and renew the first token."""
    wrong = context.one(WrongSecrets).take()
    if wrong:
        server_log.warning("requests refused within a minute: %s", wrong)
    uses = context.one(LastUses).take()
    if uses:
        try:
            _note(context, uses)
        except BaseException:
            context.one(LastUses).put_back(uses)
            raise
    file = context.settings.token_file
    with context.database.read() as session:
        is_due = is_first_token_due(session, file)
    if is_due:
        with context.database.write() as session:
            # This first statement waits for the turn to write: another service may have
            # renewed the token meanwhile.
            Tokens(session).end_expired_sessions(utc_now())
            renew_first_token(session, file)


def _note(context: ServiceContext, uses: dict[int, datetime]) -> None:
    with context.database.write() as session:
        for token_id, at in sorted(uses.items()):
            Tokens(session).note_use(token_id, at)
