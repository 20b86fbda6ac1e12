"""Readiness: checks whether this process can write to the database and the storage."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Final

from anyio import CapacityLimiter, Lock, to_thread
from sqlalchemy.exc import DBAPIError, SQLAlchemyError

from app.background import Failures
from app.context import ServiceContext
from app.db.migrate import current_revision, head_revision
from app.db.transient import takes_writes
from app.errors import NotReady, TryLater
from app.logs import error_log
from app.maintenance.sqlite_check import ADVICE
from app.package import migrations_dir
from app.process.loop_watch import LoopWatch
from app.storage.room import free_bytes
from unghost.wire.model import Fault

RETRY_S: Final = 5
GOOD_FOR_S: Final = 1.0
"""How long a result is cached: anybody may request it, and checks write to the disk."""


class Readiness:
    """Checks the service, once for all requests at about the same time."""

    def __init__(self, loop: LoopWatch) -> None:
        self._loop = loop
        self._lock = Lock()
        # A thread of its own: those of the requests may all be busy.
        self._thread = CapacityLimiter(1)
        self._found: tuple[dict[str, str], list[Fault]] = {}, []
        self._at = float("-inf")

    async def check(self, context: ServiceContext) -> Mapping[str, str]:
        """The result of each check, if all succeeded.

        Raises NotReady with one fault per check that failed.
        """
        if context.engine.stopping.is_set():
            raise _not_ready([_fault("shutdown", "the service is stopping")])
        async with self._lock:
            if time.monotonic() - self._at >= GOOD_FOR_S:
                self._found = await to_thread.run_sync(
                    _run_checks, context, limiter=self._thread
                )
                self._at = time.monotonic()
            checks, faults = self._found
        try:
            checks = {**checks, "event_loop": self._loop.check()}
        except NotReady as exc:
            faults = [*faults, _fault("event_loop", str(exc))]
        if faults:
            raise _not_ready(faults)
        return checks


def _fault(check: str, detail: str) -> Fault:
    return Fault(pointer="", code=check, detail=detail)


def _not_ready(faults: list[Fault]) -> NotReady:
    text = "; ".join(f"{fault.code}: {fault.detail}" for fault in faults)
    return NotReady(text, retry_after_s=RETRY_S, faults=faults)


def _run_checks(context: ServiceContext) -> tuple[dict[str, str], list[Fault]]:
    """The results of the checks, and the faults of those that failed."""
    checks: Mapping[str, Callable[[ServiceContext], str]] = {
        "database": lambda of: (
            "writable" if takes_writes(of.database) else "locked by another writer"
        ),
        "pages": _pages_are_intact,
        "migrations": _schema_is_current,
        "disk": _disk_has_room,
        "blobs": _storage_takes_files,
        "background": _background_tasks_succeed,
    }
    results: dict[str, str] = {}
    faults: list[Fault] = []
    for name, run in checks.items():
        try:
            results[name] = run(context)
        except (TryLater, SQLAlchemyError, OSError) as exc:
            detail = _reason(exc)
            error_log.warning("not ready: %s: %s", name, detail)
            faults.append(_fault(name, detail))
    return results, faults


def _reason(exc: Exception) -> str:
    if isinstance(exc, TryLater):
        return str(exc)
    if isinstance(exc, OSError):
        return exc.strerror or "cannot be used"
    if not isinstance(exc, SQLAlchemyError):
        return "failed; the log says more"
    # Messages of PostgreSQL may name hosts and users; anybody may read this response.
    if isinstance(exc, DBAPIError) and "sqlite" in type(exc.orig).__module__:
        return str(exc.orig)
    return "does not answer"


def _pages_are_intact(context: ServiceContext) -> str:
    database = context.database
    if database.damage is not None:
        raise NotReady(f"the database is damaged: {database.damage}; {ADVICE}")
    if database.file is None:
        return "checked by PostgreSQL"
    return "intact" if database.pages_checked else "not checked yet"


def _schema_is_current(context: ServiceContext) -> str:
    current = current_revision(context.database.engine)
    head = head_revision(migrations_dir())
    if current == head:
        return f"at {current}"
    advice = "a newer version of Unghost has migrated it"
    if (current or "") < (head or ""):
        advice = "restart to migrate it"
    raise NotReady(f"the schema is at {current}, this version needs {head}: {advice}")


def _disk_has_room(context: ServiceContext) -> str:
    free = free_bytes((context.settings.data, context.storage.temporary_folder()))
    needed = int(context.settings.min_free_bytes)
    if free < needed:
        raise NotReady(f"{free} bytes are free, {needed} are needed")
    return f"{free} bytes free"


def _storage_takes_files(context: ServiceContext) -> str:
    context.storage.check()
    return "writable"


def _background_tasks_succeed(context: ServiceContext) -> str:
    failures = dict(context.one(Failures))
    if failures:
        texts = (f"{message}: {_reason(exc)}" for message, exc in failures.items())
        raise NotReady("; ".join(texts))
    return "working"
