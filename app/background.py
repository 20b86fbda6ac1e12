"""Threads that repeat a task while the service runs, and the tasks that fail now."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Final

from sqlalchemy.exc import SQLAlchemyError

from app.context import ServiceContext
from app.db.transient import in_a_line, is_transient
from app.memory import forget_tracebacks

RETRY_S: Final = 5.0
"""Seconds after which a task that has failed is tried again, if not earlier."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Task:
    """Something that the thread `name` repeats every `every_s` seconds.

    `work` does it once, for a `purpose`, as messages say: ``cannot PURPOSE yet``. Set
    `wake` to let it begin at once.
    """

    name: str
    purpose: str
    work: Callable[[], None]
    every_s: float
    wake: threading.Event = field(default_factory=threading.Event)


class Failures(dict[str, Exception]):
    """What each failing task of this process last failed with, by its message.

    Without errors that pass, such as a lock or a lost connection.
    """


@contextmanager
def repeating(context: ServiceContext, task: Task) -> Iterator[None]:
    """Repeat a task in a thread until the block ends or the service stops.

    No error ends the thread: it is logged, and the task is tried again.
    """
    over, failures = threading.Event(), context.one(Failures)

    def repeat() -> None:
        while True:
            failed = message_of(task) in failures
            task.wake.wait(min(RETRY_S, task.every_s) if failed else task.every_s)
            task.wake.clear()
            if over.is_set() or context.engine.stopping.is_set():
                return
            attempt(context, task)

    thread = threading.Thread(target=repeat, name=task.name)
    thread.start()
    try:
        yield
    finally:
        over.set()
        task.wake.set()
        thread.join()


def attempt(context: ServiceContext, task: Task) -> None:
    """Do a task once; an error is logged, and kept until the task succeeds."""
    failures, message = context.one(Failures), message_of(task)
    try:
        task.work()
    except Exception as exc:
        if isinstance(exc, (SQLAlchemyError, OSError)):
            log.warning("%s: %s", message, in_a_line(exc))
        else:
            log.exception("%s", message)
        forget_tracebacks(exc)
        if not is_transient(exc):
            failures[message] = exc
    else:
        failures.pop(message, None)


def message_of(task: Task) -> str:
    """The beginning of the message that a task fails."""
    return f"cannot {task.purpose} yet"
