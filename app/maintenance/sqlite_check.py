"""Checks the pages of a SQLite database for damage, once after each start.

The check runs in the background, for at most a minute: a large database takes longer.
Damage that any reader finds later is recorded as well (`Database.damage`).
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from sqlalchemy.exc import SQLAlchemyError

from app.context import ServiceContext
from app.db.engine import Database

LONGEST_S: Final = 60.0
ADVICE: Final = (
    "stop the service, keep a copy of its folder, and restore the last backup into "
    "another one; `unghost doctor` on the server says more"
)

log = logging.getLogger(__name__)


@contextmanager
def checking_for_damage(context: ServiceContext) -> Iterator[None]:
    """Check the pages in a background thread, which ends with the block."""
    stop, database = threading.Event(), context.database
    check = threading.Thread(target=_check, args=(database, stop), name="damage check")
    if database.file is not None:
        check.start()
    try:
        yield
    finally:
        stop.set()
        if database.file is not None:
            check.join()


def _check(database: Database, stop: threading.Event) -> None:
    until = time.monotonic() + LONGEST_S
    try:
        whole = database.check_pages(lambda: stop.is_set() or time.monotonic() > until)
    except SQLAlchemyError as exc:
        log.warning("the pages of the database cannot be checked: %s", exc)
        return
    if database.damage is not None:
        log.error("the database is damaged: %s; %s", database.damage, ADVICE)
    elif whole:
        log.info("the pages of the database are intact")
    elif not stop.is_set():
        log.info(
            "the pages of the database are too many to check in %d s; "
            "`unghost doctor` checks all of them",
            LONGEST_S,
        )
