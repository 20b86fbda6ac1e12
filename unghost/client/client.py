"""`Client`: sends API calls, fetches pages of lists, follows jobs, uploads frames."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Generator, Iterable, Iterator
from contextlib import closing
from dataclasses import replace
from itertools import islice
from types import TracebackType
from typing import TYPE_CHECKING, Final, TypeVar

import httpx

from unghost.client.api import READINESS, Api, dataset_path
from unghost.client.call import Call, Listing
from unghost.client.discovery import find_server
from unghost.client.errors import Unavailable
from unghost.client.jobs import JobMethods
from unghost.client.outgoing import NotSent, Outcome, OutgoingFrame
from unghost.client.tables import AsyncBoxes, Boxes
from unghost.client.transport import (
    DEFAULT_TIMEOUT,
    AsyncTransport,
    RetryPolicy,
    Transport,
)

if TYPE_CHECKING:
    from os import PathLike
    from pathlib import Path

    from unghost.wire.boxes import Decision
    from unghost.wire.runs import Export, Run

T = TypeVar("T")
ClientT = TypeVar("ClientT", bound="Client")

_DEFAULT_RETRY: Final = RetryPolicy()


class Client(Api, JobMethods):
    """A connection to an Unghost server.

    Without arguments it connects to the server in `UNGHOST_SERVER` or, if that is not
    set, to the one on this machine, whose token it finds. Safe to use from threads.

    A call waits for a server that is away or busy: `retry_for` seconds (0: not at all),
    two minutes by default. `retry` also has the delays in between.

        with Client() as client:
            for box in client.boxes("town10", verdict="rejected"):
                print(box.frame, box.id, box.explanation)
    """

    def __init__(
        self,
        url: str | None = None,
        token: str | None = None,
        *,
        timeout: float | httpx.Timeout = DEFAULT_TIMEOUT,
        retry: RetryPolicy = _DEFAULT_RETRY,
        retry_for: float | None = None,
    ) -> None:
        server = find_server(url, token)
        self.url = server.url
        self.token = server.token
        if retry_for is not None:
            retry = replace(retry, for_s=retry_for)
        self._server, self._retry = server, retry
        self._transport = Transport(server, timeout=timeout, retry=retry)

    def __repr__(self) -> str:
        # Without the token, because representations are often logged.
        return f"Client({self.url!r})"

    def __enter__(self: ClientT) -> ClientT:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._transport.close()

    def ready(self) -> bool:
        """Whether the server is ready; sends one request, without retries."""
        try:
            self._send(READINESS)
        except Unavailable:
            return False
        return True

    def push(
        self,
        dataset: str,
        frames: Iterable[OutgoingFrame | NotSent],
        *,
        replace: bool = False,
        connections: int = 2,
        progress: Callable[[int], object] | None = None,
    ) -> Generator[Outcome, None, None]:
        """Store many frames; yields the outcome of each as soon as it is known.

        Frames are sent in batches, and their files are streamed from the disk. Frames
        that the server already has are not sent. A frame that the server refuses gives
        an outcome (`NotSent`), not an exception. If a connection breaks, it is opened
        again, and the frames without a result are sent again. If the server stays away,
        `Unavailable` says how many frames are stored; the same push sends the rest.
        Closing the iterator early stops the upload. `progress` is called with the
        number of frames that have an outcome.

            frames = (OutgoingFrame(p.stem, boxes_of(p), {"image": p}) for p in paths)
            for outcome in client.push("town10", frames):
                print(outcome.key, outcome.word)
        """
        # Imported here, because most programs only read and never push.
        from unghost.client.push import Upload

        upload = Upload(self._transport, dataset_path(dataset), replace, connections)
        with closing(upload.send(frames)) as outcomes:
            for number, outcome in enumerate(outcomes, start=1):
                if progress is not None:
                    progress(number)
                yield outcome

    def _send(self, call: Call[T]) -> T:
        return self._transport.send(call)

    def _boxes(self, listing: Listing[Decision]) -> Boxes:
        return Boxes(self, listing)

    def _pages(self, listing: Listing[T]) -> Iterator[T]:
        """Every item of a list; a page is fetched when its first item is needed."""
        cursor: str | None = None
        while True:
            page = self._send(listing.page(cursor))
            yield from page.items
            cursor = page.next_cursor
            if cursor is None:
                return


class AsyncClient(Api):
    """A `Client` for programs with an event loop: every call is awaited.

    It has the same methods; lists are read by ``async for``. What follows a job or
    streams files (`wait`, `events`, `download`, `push` and so on) works in a thread.

        async with AsyncClient() as client:
            async for box in client.boxes("town10", verdict="rejected"):
                print(box.frame, box.id, box.explanation)
    """

    def __init__(
        self,
        url: str | None = None,
        token: str | None = None,
        *,
        timeout: float | httpx.Timeout = DEFAULT_TIMEOUT,
        retry: RetryPolicy = _DEFAULT_RETRY,
        retry_for: float | None = None,
    ) -> None:
        threaded = Client(url, token, timeout=timeout, retry=retry, retry_for=retry_for)
        self.url, self.token = threaded.url, threaded.token
        self._threaded = threaded
        self._transport = AsyncTransport(
            threaded._server, timeout=timeout, retry=threaded._retry
        )

    def __repr__(self) -> str:
        # Without the token, because representations are often logged.
        return f"AsyncClient({self.url!r})"

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connections."""
        self._threaded.close()
        await self._transport.close()

    async def ready(self) -> bool:
        """Whether the server is ready; sends one request, without retries."""
        try:
            await self._send(READINESS)
        except Unavailable:
            return False
        return True

    def push(
        self,
        dataset: str,
        frames: Iterable[OutgoingFrame | NotSent],
        *,
        replace: bool = False,
        connections: int = 2,
        progress: Callable[[int], object] | None = None,
    ) -> AsyncIterator[Outcome]:
        """Store many frames, as `Client.push` does."""
        return _in_thread(
            self._threaded.push(
                dataset,
                frames,
                replace=replace,
                connections=connections,
                progress=progress,
            )
        )

    def events(self, run: Run | int) -> AsyncIterator[Run]:
        """Yields a run each time it changes, until it has ended."""
        return _in_thread(self._threaded.events(run))

    def export_events(self, export: Export | int) -> AsyncIterator[Export]:
        """Yields an export each time it changes, until it has ended."""
        return _in_thread(self._threaded.export_events(export))

    async def wait(
        self,
        run: Run | int,
        *,
        progress: Callable[[Run], object] | None = None,
        timeout_s: float | None = None,
    ) -> Run:
        """Wait for a run, as `Client.wait` does."""
        wait = self._threaded.wait
        return await asyncio.to_thread(
            wait, run, progress=progress, timeout_s=timeout_s
        )

    async def wait_for_export(
        self,
        export: Export | int,
        *,
        progress: Callable[[Export], object] | None = None,
        timeout_s: float | None = None,
    ) -> Export:
        """Wait for an export, as `Client.wait_for_export` does."""
        wait = self._threaded.wait_for_export
        return await asyncio.to_thread(
            wait, export, progress=progress, timeout_s=timeout_s
        )

    async def download(
        self,
        export: Export,
        path: str | PathLike[str],
        *,
        progress: Callable[[int, int | None], object] | None = None,
    ) -> Path:
        """Download a finished export, as `Client.download` does."""
        download = self._threaded.download
        return await asyncio.to_thread(download, export, path, progress=progress)

    async def _send(self, call: Call[T]) -> T:
        return await self._transport.send(call)

    def _boxes(self, listing: Listing[Decision]) -> AsyncBoxes:
        return AsyncBoxes(self, listing)

    async def _pages(self, listing: Listing[T]) -> AsyncIterator[T]:
        cursor: str | None = None
        while True:
            page = await self._send(listing.page(cursor))
            for item in page.items:
                yield item
            cursor = page.next_cursor
            if cursor is None:
                return


async def _in_thread(items: Iterator[T]) -> AsyncIterator[T]:
    """The items of an iterator that blocks."""

    def step() -> list[T]:
        return list(islice(items, 1))

    try:
        while found := await asyncio.to_thread(step):
            yield found[0]
    finally:
        close = getattr(items, "close", None)
        if close is not None:
            await asyncio.to_thread(close)
