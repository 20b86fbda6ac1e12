"""`Client`: sends API calls, fetches pages of lists, follows jobs, uploads frames."""

from __future__ import annotations

import asyncio
from collections.abc import (
    AsyncIterator,
    Callable,
    Coroutine,
    Generator,
    Iterable,
    Iterator,
)
from contextlib import closing
from dataclasses import replace
from functools import wraps
from itertools import islice
from types import TracebackType
from typing import TYPE_CHECKING, Concatenate, Final, ParamSpec, TypeVar

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
    from unghost.wire.boxes import Decision

T = TypeVar("T")
P = ParamSpec("P")
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
        from unghost.client.push import upload

        sent = upload(
            self._transport,
            dataset_path(dataset),
            frames,
            replace=replace,
            connections=connections,
        )
        with closing(sent) as outcomes:
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
            items, cursor = self._send(listing.page(cursor))
            yield from items
            if cursor is None:
                return


def _in_thread(
    method: Callable[Concatenate[Client, P], T],
) -> Callable[Concatenate[AsyncClient, P], Coroutine[object, object, T]]:
    """A method that waits, of the client that blocks, in a thread."""

    @wraps(method)
    def awaited(
        client: AsyncClient, /, *args: P.args, **kwargs: P.kwargs
    ) -> Coroutine[object, object, T]:
        return asyncio.to_thread(method, client._threaded, *args, **kwargs)

    return awaited


def _items_in_thread(
    method: Callable[Concatenate[Client, P], Iterator[T]],
) -> Callable[Concatenate[AsyncClient, P], AsyncIterator[T]]:
    """A method that yields items, each in a thread."""

    @wraps(method)
    async def items(
        client: AsyncClient, /, *args: P.args, **kwargs: P.kwargs
    ) -> AsyncIterator[T]:
        blocking = method(client._threaded, *args, **kwargs)
        try:
            while head := await asyncio.to_thread(lambda: list(islice(blocking, 1))):
                yield head[0]
        finally:
            close = getattr(blocking, "close", None)
            if close is not None:
                await asyncio.to_thread(close)

    return items


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

    push = _items_in_thread(Client.push)
    events = _items_in_thread(Client.events)
    export_events = _items_in_thread(Client.export_events)
    wait = _in_thread(Client.wait)
    wait_for_export = _in_thread(Client.wait_for_export)
    download = _in_thread(Client.download)

    async def _send(self, call: Call[T]) -> T:
        return await self._transport.send(call)

    def _boxes(self, listing: Listing[Decision]) -> AsyncBoxes:
        return AsyncBoxes(self, listing)

    async def _pages(self, listing: Listing[T]) -> AsyncIterator[T]:
        cursor: str | None = None
        while True:
            items, cursor = await self._send(listing.page(cursor))
            for item in items:
                yield item
            if cursor is None:
                return
