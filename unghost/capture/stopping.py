"""Ctrl-C, a polite kill, a closed terminal: noted, acted on where nothing is lost."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

_SIGNALS: Final = tuple(
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
    if hasattr(signal, name)
)
_HANG_UP: Final = getattr(signal, "SIGHUP", None)


class StopRequest:
    """Whether somebody wants the capture to end."""

    def __init__(self) -> None:
        self.asked = False

    def check(self) -> None:
        """Raise KeyboardInterrupt if somebody asked; called between two acts."""
        if self.asked:
            raise KeyboardInterrupt

    def take(self, _number: int, _frame: FrameType | None) -> None:
        """However many signals come, they wait for the next `check`."""
        self.asked = True


@contextmanager
def listening_for_stop() -> Iterator[StopRequest]:
    """Signals become requests: an actor is never spawned without being noted down."""
    request = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield request
        return
    before = [(each, signal.signal(each, request.take)) for each in _wanted()]
    try:
        yield request
    finally:
        for each, handler in before:
            signal.signal(each, handler)


def _wanted() -> list[signal.Signals]:
    # Who starts a capture with `nohup` wants it to outlive the terminal.
    kept = signal.SIG_IGN if _HANG_UP is None else signal.getsignal(_HANG_UP)
    return [each for each in _SIGNALS if each != _HANG_UP or kept is not signal.SIG_IGN]


@contextmanager
def shielded() -> Iterator[None]:
    """Signals wait until the block is done: nothing may cut short the putting back."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    missed: list[int] = []
    before = [
        (each, signal.signal(each, lambda number, _: missed.append(number)))
        for each in _wanted()
    ]
    try:
        yield
    finally:
        for each, handler in before:
            signal.signal(each, handler)
