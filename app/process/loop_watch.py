"""A watchdog thread that logs when the event loop is blocked, and by which code.

While it is blocked, no request is served. Nothing in the service should block the event
loop for more than some milliseconds: longer work belongs in a thread.
"""

from __future__ import annotations

import asyncio
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

from app.errors import NotReady
from app.logs import server_log
from app.metrics import LOOP_STALL_SECONDS, LOOP_STALLS

LONGEST_S: Final = 1.0
"""How long the loop may take to run a callback."""
NOT_READY_FOR_S: Final = 5.0
"""How long a process is not ready after its loop was blocked.

The cause is likely to occur again.
"""
_EVERY_S: Final = 0.25


class LoopWatch:
    """Schedules a callback on the loop four times a second, and measures its delay."""

    def __init__(self) -> None:
        self._over = threading.Event()
        self._is_blocked = False
        self._ended_at = float("-inf")
        self._lasted_s = 0.0

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Watch the loop that runs in this thread."""
        loop = asyncio.get_running_loop()
        thread = threading.Thread(
            target=self._watch,
            args=(loop, threading.get_ident()),
            name="loop-watch",
            daemon=True,
        )
        thread.start()
        try:
            yield
        finally:
            self._over.set()

    def check(self) -> str:
        """The state of the loop, for the report on readiness.

        Raises NotReady: it is blocked, or was so a moment ago.
        """
        if self._is_blocked:
            raise NotReady(f"blocked for more than {LONGEST_S:g} s")
        if time.monotonic() - self._ended_at < NOT_READY_FOR_S:
            raise NotReady(f"was blocked for {self._lasted_s:.1f} s until just now")
        return "responsive"

    def _watch(self, loop: asyncio.AbstractEventLoop, thread_id: int) -> None:
        with suppress(RuntimeError):  # the loop is closed
            while not self._over.wait(_EVERY_S):
                answered, asked_at = threading.Event(), time.monotonic()
                loop.call_soon_threadsafe(answered.set)
                if not answered.wait(LONGEST_S):
                    self._wait_for(answered, asked_at, thread_id)

    def _wait_for(
        self, answered: threading.Event, asked_at: float, thread_id: int
    ) -> None:
        """Log what blocks the loop, and when it runs again."""
        self._is_blocked = True
        LOOP_STALLS.inc()
        calls = traceback.extract_stack(sys._current_frames().get(thread_id))
        stack = [f"{call.filename}:{call.lineno} {call.name}" for call in calls]
        server_log.error(
            "the event loop has been blocked for more than %g s",
            LONGEST_S,
            extra={"facts": {"stack": stack}},
        )
        while not answered.wait(_EVERY_S):
            if self._over.is_set():
                return
        self._ended_at = time.monotonic()
        self._lasted_s = self._ended_at - asked_at
        self._is_blocked = False
        LOOP_STALL_SECONDS.inc(self._lasted_s)
        server_log.warning("the event loop runs again after %.1f s", self._lasted_s)
