"""Many frames to the server at once: bounded, safe to interrupt and to repeat."""

from __future__ import annotations

import threading
from collections.abc import Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import islice
from queue import Empty, SimpleQueue
from typing import Final, TypeAlias, TypeVar

from unghost.batches import HOPELESS, BatchSender, Tell
from unghost.errors import ApiError, NotFound
from unghost.known import KnownFrames
from unghost.outgoing import AlreadyThere, NotSent, Outcome, OutgoingFrame, Sent
from unghost.packing import PackedFrame, pack
from unghost.put import put
from unghost.retry import PATIENCE
from unghost.transport import Transport

_LOOKED_UP: Final = 250
"""Frames that are asked about in one request."""
_BATCH_FRAMES: Final = 200
"""Well below what the buffers of a connection hold of the answer."""
_BATCH_BYTES: Final = 256 << 20
_LISTEN_S: Final = 0.5

ItemT = TypeVar("ItemT")
Batch: TypeAlias = Sequence[PackedFrame]


@dataclass(frozen=True)
class Upload:
    """How to send frames: where to, and on how many connections at once.

    `path` is the dataset's. `replace` makes changed frames new revisions instead of
    conflicts.
    """

    transport: Transport
    path: str
    replace: bool = False
    connections: int = 2

    def send(
        self, frames: Iterable[OutgoingFrame | NotSent]
    ) -> Generator[Outcome, None, None]:
        """Send frames; yields outcomes as they come, in any order.

        What the server has already is not sent. What a reader could not read
        (`NotSent`) is passed on. `frames` is consumed no faster than it is sent: memory
        does not grow with it.
        Stopping early sends nothing more. What concerns every frame (no access, no
        such dataset, no server) is raised; what concerns one is its outcome.
        """
        with _Senders(self) as senders:
            for batch in _batches(self._wanted(frames)):
                if isinstance(batch, AlreadyThere | NotSent):
                    yield batch
                else:
                    senders.submit(batch)
                yield from senders.outcomes(self.connections)
            yield from senders.outcomes(0)

    def _wanted(
        self, frames: Iterable[OutgoingFrame | NotSent]
    ) -> Iterator[PackedFrame | AlreadyThere | NotSent]:
        """Frames to be sent, packed, and outcomes of those that need not be."""
        known = KnownFrames(self.transport, self.path)
        number = 0
        for window in _windows(frames, _LOOKED_UP):
            for frame in known.sorted_out(window):
                if not isinstance(frame, OutgoingFrame):
                    yield frame
                    continue
                try:
                    yield pack(frame, f"{number:06}")
                except (OSError, ValueError) as error:
                    yield NotSent(frame.key, error)
                number += 1


class _Senders:
    """Threads with a connection each, and what they have to tell."""

    def __init__(self, upload: Upload) -> None:
        self._upload = upload
        self._told: SimpleQueue[Outcome | Future[None]] = SimpleQueue()
        self._pool = ThreadPoolExecutor(upload.connections, "upload")
        self._own = threading.local()
        self._all: list[BatchSender] = []
        self._stopped = threading.Event()
        self._under_way = 0
        # A proxy would hold back the answer to a batch.
        self._singly = upload.transport.behind_proxy

    def __enter__(self) -> _Senders:
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        for sender in tuple(self._all):
            sender.close()
        self._pool.shutdown(cancel_futures=True)

    def submit(self, batch: Batch) -> None:
        """Have a batch sent as soon as a connection is free."""
        self._under_way += 1
        self._pool.submit(self._send, batch).add_done_callback(self._told.put)

    def outcomes(self, most: int) -> Iterator[Outcome]:
        """What has been told; waits until at most so many batches are under way."""
        while self._under_way > most or not self._told.empty():
            try:
                # Not for ever: on Windows nothing else lets an interruption through.
                told = self._told.get(timeout=_LISTEN_S)
            except Empty:
                continue
            if isinstance(told, Future):
                self._under_way -= 1
                told.result()
            else:
                yield told

    def _send(self, batch: Batch) -> None:
        tell: Tell = self._told.put
        try:
            if not self._singly:
                self._sender().send(batch, tell)
                return
        except NotFound:
            # An older server. Or the dataset is gone, which every frame will say.
            self._singly = True
        for packed in batch:
            if self._stopped.is_set():
                return
            tell(self._put(packed.frame))

    def _put(self, frame: OutgoingFrame) -> Outcome:
        """One request for one frame."""
        upload = self._upload
        try:
            stored = put(upload.transport, upload.path, frame, replace=upload.replace)
        except HOPELESS:
            raise
        except (ApiError, OSError) as error:
            return NotSent(frame.key, error)
        return Sent(frame.key, stored.frame.id, stored.created, stored.frame.counts)

    def _sender(self) -> BatchSender:
        """This thread's own."""
        if hasattr(self._own, "sender"):
            known: BatchSender = self._own.sender
            return known
        upload = self._upload
        endpoint = upload.transport.endpoint(
            f"{upload.path}/batches", {"replace": upload.replace or None}
        )
        once = upload.transport.retry
        patient = replace(once, attempts=PATIENCE * once.attempts)
        sender = BatchSender(endpoint, patient, self._wait)
        self._own.sender = sender
        self._all.append(sender)
        return sender

    def _wait(self, seconds: float) -> bool:
        return not self._stopped.wait(seconds) and not self._upload.transport.closed


def _batches(
    items: Iterable[PackedFrame | AlreadyThere | NotSent],
) -> Iterator[Batch | AlreadyThere | NotSent]:
    batch: list[PackedFrame] = []
    size = 0
    for item in items:
        if not isinstance(item, PackedFrame):
            yield item
            continue
        if batch and (len(batch) == _BATCH_FRAMES or size + item.size > _BATCH_BYTES):
            yield batch
            batch, size = [], 0
        batch.append(item)
        size += item.size
    if batch:
        yield batch


def _windows(items: Iterable[ItemT], size: int) -> Iterator[list[ItemT]]:
    source = iter(items)
    while window := list(islice(source, size)):
        yield window
