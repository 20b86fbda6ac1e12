"""`Client`: sends API calls, fetches pages of lists, follows jobs, uploads frames."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from types import TracebackType
from typing import Final, TypeVar

import httpx

from unghost.client.api import READINESS, Api, dataset_path
from unghost.client.call import Call, Listing
from unghost.client.discovery import find_server
from unghost.client.errors import Unavailable
from unghost.client.jobs import JobMethods
from unghost.client.outgoing import NotSent, Outcome, OutgoingFrame
from unghost.client.transport import DEFAULT_TIMEOUT, RetryPolicy, Transport

T = TypeVar("T")
ClientT = TypeVar("ClientT", bound="Client")

_DEFAULT_RETRY: Final = RetryPolicy()


class Client(Api, JobMethods):
    """A connection to an Unghost server.

    Without arguments it connects to the server in `UNGHOST_SERVER` or, if that is not
    set, to the one on this machine, whose token it finds. Safe to use from threads.

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
    ) -> None:
        server = find_server(url, token)
        self.url = server.url
        self.token = server.token
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
    ) -> Generator[Outcome, None, None]:
        """Store many frames; yields the outcome of each as soon as it is known.

        Frames are sent in batches, and their files are streamed from the disk. Frames
        that the server already has are not sent. A frame that the server refuses gives
        an outcome (`NotSent`), not an exception. If a connection breaks, it is opened
        again, and the frames without a result are sent again. Closing the iterator
        early stops the upload.

            frames = (OutgoingFrame(p.stem, boxes_of(p), {"image": p}) for p in paths)
            for outcome in client.push("town10", frames):
                print(outcome.key, outcome.word)
        """
        # Imported here, because most programs only read and never push.
        from unghost.client.push import Upload

        upload = Upload(self._transport, dataset_path(dataset), replace, connections)
        return upload.send(frames)

    def _send(self, call: Call[T]) -> T:
        return self._transport.send(call)

    def _pages(self, listing: Listing[T]) -> Iterator[T]:
        """Every item of a list; a page is fetched when its first item is needed."""
        cursor: str | None = None
        while True:
            page = self._send(listing.page(cursor))
            yield from page.items
            cursor = page.next_cursor
            if cursor is None:
                return
