"""A server that says when it is ready, and that ends what it began before it stops."""

from __future__ import annotations

import asyncio
import faulthandler
import os
import signal
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from types import FrameType
from typing import Any, Final

import uvicorn

from app.logs import server_log

LAST_S: Final = 15
"""Seconds after those of the requests; then the process ends, whatever it does."""
_LOOK_S: Final = 0.05


class GracefulServer(uvicorn.Server):
    """Uvicorn; the first signal lets it finish, the second one ends it at once.

    Until the last request is over it goes on listening, so that whoever asks whether
    it is ready gets an answer, and whoever sends something new is told to come back.
    """

    def __init__(
        self,
        config: uvicorn.Config,
        *,
        ready: Callable[[], None],
        stopping: Callable[[], None],
        wait_s: float,
    ) -> None:
        super().__init__(config)
        self._ready, self._stopping, self._wait_s = ready, stopping, wait_s

    async def main_loop(self) -> None:
        """Say that it has started, and serve: a stop from here on is a clean one."""
        # It writes to the database, which may keep it waiting: not on the loop.
        await asyncio.to_thread(self._ready)
        await super().main_loop()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Say so, finish, and stop listening; then the work behind it is ended."""
        until = time.monotonic() + self._wait_s
        begun = set(self.server_state.tasks)
        server_log.info("stopping: %d requests are open", len(begun))
        _end_after(self._wait_s + LAST_S)
        self._stopping()
        while _goes_on(begun) and time.monotonic() < until:
            await asyncio.sleep(_LOOK_S)
        cut_off = _goes_on(begun)
        if cut_off:
            server_log.warning("%d requests are cut off: they took too long", cut_off)
        left_s = max(1, int(until - time.monotonic()))
        self.config.timeout_graceful_shutdown = left_s
        await _cancelled(begun)
        await super().shutdown(sockets)
        faulthandler.cancel_dump_traceback_later()
        server_log.info("stopped")

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """A signal: what was acknowledged is durable, so one may end at any moment."""
        if self.should_exit:
            with suppress(RuntimeError):  # it may have come in the middle of a line
                server_log.warning("ended by a second signal")
            os._exit(128 + sig)
        # If the loop stands still it never learns of the signal: no lock is taken here.
        with suppress(ValueError, OSError, AttributeError):
            faulthandler.dump_traceback_later(self._wait_s + 2 * LAST_S, exit=True)
        super().handle_exit(sig, frame)


def exit_on_sigterm() -> None:
    """Let SIGTERM end the process with 0; the next one kills it."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, _exit)


def _exit(*_: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    raise SystemExit(0)


def _goes_on(tasks: set[asyncio.Task[Any]]) -> int:
    return sum(not task.done() for task in tasks)


async def _cancelled(tasks: set[asyncio.Task[Any]]) -> None:
    """End tasks and let them say so to whoever waits for their answers."""
    left = [task for task in tasks if not task.done()]
    for task in left:
        task.cancel()
    if left:
        await asyncio.wait(left, timeout=1)


def _end_after(seconds: float) -> None:
    def end() -> None:
        server_log.error("the work did not end in time: the process does")
        os._exit(1)

    watchdog = threading.Timer(seconds, end)
    watchdog.daemon = True
    watchdog.start()
