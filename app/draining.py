"""While the service stops: what goes on is finished, and nothing new is begun."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Final

from starlette.types import ASGIApp, Receive, Scope, Send

from app.engine import Stop
from app.errors import NotReady
from app.security import SAFE_METHODS

RETRY_S: Final = 5


def stopping() -> NotReady:
    """What is said to those who came too late."""
    return NotReady("the service stops; try again later", retry_after_s=RETRY_S)


class NoNewWork:
    """Refuses requests that write once the service stops; those that read are served.

    A request that its time limit ends is told so as well.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        stop: Stop = scope["app"].state.services.engine.stopping
        if stop.is_set() and scope["method"] not in SAFE_METHODS:
            raise stopping()
        try:
            await self._app(scope, receive, send)
        except asyncio.CancelledError:
            if not stop.is_set():
                raise
            raise stopping() from None


class UntilStopped:
    """Pieces of a body, until there are no more or the service stops.

    A sender may pause for as long as it likes: who waits for it is woken. Between two
    pieces this costs next to nothing.

    Raises
    ------
    NotReady
        The service stops. What was read before is not lost.
    """

    def __init__(self, pieces: AsyncIterator[bytes], stop: Stop) -> None:
        self._pieces, self._stop = pieces, stop
        self._loop = asyncio.get_running_loop()
        self._reader: asyncio.Task[object] | None = None
        self._is_woken = False

    def __aiter__(self) -> UntilStopped:
        """Itself: reading goes on where it was left."""
        return self

    async def __anext__(self) -> bytes:
        """The next piece."""
        if self._stop.is_set():
            raise stopping()
        self._reader = asyncio.current_task()
        try:
            return await anext(self._pieces)
        except asyncio.CancelledError:
            if not self._is_woken:
                raise
            _take_back(self._reader)
            raise stopping() from None
        finally:
            self._reader = None

    def wake(self) -> None:
        """Let who waits for a piece know that the service stops; from any thread."""
        self._loop.call_soon_threadsafe(self._interrupt)

    def _interrupt(self) -> None:
        if self._reader is not None:
            self._is_woken = True
            self._reader.cancel()


def _take_back(task: asyncio.Task[object] | None) -> None:
    # From Python 3.11 on a task remembers that it was cancelled until it is told.
    uncancel = getattr(task, "uncancel", None)
    if uncancel is not None:
        uncancel()
