"""Ctrl-C and a polite kill: taken note of, acted on where nothing can be lost."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)


class StopRequest:
    """Whether somebody wants the capture to end."""

    def __init__(self) -> None:
        self.asked = False

    def check(self) -> None:
        """Raise KeyboardInterrupt if somebody asked; called between two acts."""
        if self.asked:
            raise KeyboardInterrupt

    def take(self, _number: int, _frame: FrameType | None) -> None:
        """The first signal waits for the next `check`; the second does not."""
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True


@contextmanager
def listening_for_stop() -> Iterator[StopRequest]:
    """Signals become requests: an actor is never spawned without being noted down."""
    request = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield request
        return
    before = [(each, signal.signal(each, request.take)) for each in _SIGNALS]
    try:
        yield request
    finally:
        for each, handler in before:
            signal.signal(each, handler)


@contextmanager
def shielded() -> Iterator[None]:
    """Signals wait until the block is done: nothing may cut short the putting back."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    missed: list[int] = []
    before = [
        (each, signal.signal(each, lambda number, _: missed.append(number)))
        for each in _SIGNALS
    ]
    try:
        yield
    finally:
        for each, handler in before:
            signal.signal(each, handler)
