"""Uploads many frames to a dataset; memory is bounded, and it can be repeated safely.

Frames that the dataset already has are skipped: the server returns the digests of
stored frames by key. The others are sent in batches, on several connections at the same
time; if batches cannot be sent, each frame is sent in a request of its own.
"""

from __future__ import annotations

import threading
from collections.abc import Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from queue import Empty, SimpleQueue
from typing import Final, TypeAlias

from unghost.client import errors
from unghost.client.api import frame_stored, known_frames
from unghost.client.batches import BatchSender
from unghost.client.outgoing import (
    AlreadyThere,
    NotSent,
    Outcome,
    OutgoingFrame,
    PackedFrame,
    Sent,
    is_text,
)
from unghost.client.transport import Transport

_HASHING: Final = 2
"""Threads that hash files; reading and hashing release the interpreter lock."""

_LOOKED_UP: Final = 250
"""Number of keys in one request for stored frames."""

_BATCH_FRAMES: Final = 200
"""Few enough for the unread response lines to fit into a connection's buffers."""

_BATCH_BYTES: Final = 256 << 20

_LISTEN_S: Final = 0.5

Batch: TypeAlias = Sequence[PackedFrame]


def upload(
    transport: Transport,
    path: str,
    frames: Iterable[OutgoingFrame | NotSent],
    *,
    replace: bool,
    connections: int,
) -> Generator[Outcome, None, None]:
    """Send frames; yields outcomes as soon as they are known, in any order.

    `path` is the dataset's. `replace` makes changed frames new revisions instead of
    conflicts.

    Frames that the server already has are not sent. Frames that could not be read
    (`NotSent`) are passed on. `frames` is consumed no faster than frames are sent,
    so memory does not grow. If the caller stops early, no more frames are sent.
    Errors that concern all frames (no access, no such dataset, no server) are
    raised; an error of one frame is its outcome.
    """
    there = 0
    try:
        with _Senders(transport, path, replace, connections) as senders:
            for outcome in senders.outcomes_of(frames):
                there += not isinstance(outcome, NotSent)
                yield outcome
    except errors.Unavailable as error:
        error.extend(
            f"{there:,} frames are stored, and pushing the same frames again sends "
            "only the others"
        )
        raise


def _digest(frame: OutgoingFrame) -> str | NotSent:
    try:
        return frame.digest()
    except (OSError, ValueError) as error:
        return NotSent(frame.key, error)


class _Senders:
    """Threads with a connection each, which send the frames that the server lacks."""

    def __init__(
        self, transport: Transport, path: str, replace: bool, connections: int
    ) -> None:
        self._transport, self._path, self._replace = transport, path, replace
        self._connections = connections
        self._finished: SimpleQueue[Outcome | Future[None]] = SimpleQueue()
        self._pool = ThreadPoolExecutor(connections, "upload")
        self._of_thread = threading.local()
        self._all: list[BatchSender] = []
        self._stopped = threading.Event()
        self._under_way = 0
        # A proxy would buffer the response to a batch.
        self._singly = transport.behind_proxy

    def __enter__(self) -> _Senders:
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        for sender in tuple(self._all):
            sender.close()
        self._pool.shutdown(cancel_futures=True)

    def outcomes_of(
        self, frames: Iterable[OutgoingFrame | NotSent]
    ) -> Iterator[Outcome]:
        """Send frames in batches, except those stored already; yields all outcomes."""
        try:
            for batch in _batches(self._packed(frames)):
                if isinstance(batch, AlreadyThere | NotSent):
                    yield batch
                else:
                    self._under_way += 1
                    sending = self._pool.submit(self._send, batch)
                    sending.add_done_callback(self._finished.put)
                yield from self._outcomes(self._connections)
            yield from self._outcomes(0)
        except errors.Unavailable:
            while not self._finished.empty():  # known when another batch has failed
                finished = self._finished.get()
                if not isinstance(finished, Future):
                    yield finished
            raise

    def _packed(
        self, frames: Iterable[OutgoingFrame | NotSent]
    ) -> Iterator[PackedFrame | AlreadyThere | NotSent]:
        """Packed frames to be sent, and outcomes of frames that need not be sent."""
        number = 0
        source = iter(frames)
        while window := list(islice(source, _LOOKED_UP)):
            for frame in self._without_known(window):
                if not isinstance(frame, OutgoingFrame):
                    yield frame
                    continue
                try:
                    yield frame.packed(f"{number:06}")
                except (OSError, ValueError) as error:
                    yield NotSent(frame.key, error)
                number += 1

    def _without_known(
        self, frames: Sequence[OutgoingFrame | NotSent]
    ) -> Iterator[OutgoingFrame | AlreadyThere | NotSent]:
        """The same frames in order; frames that need not be sent become outcomes.

        Only the files of frames whose key is stored are read, to compare the content.
        """
        # A file name need not be valid UTF-8: such a key is refused when it is packed.
        keys = [
            frame.key
            for frame in frames
            if isinstance(frame, OutgoingFrame) and is_text(frame.key)
        ]
        stored = self._transport.send(known_frames(self._path, keys)) if keys else {}
        compared = (
            frame
            for frame in frames
            if isinstance(frame, OutgoingFrame) and frame.key in stored
        )
        with ThreadPoolExecutor(_HASHING, "compare") as pool:
            digests = iter(list(pool.map(_digest, compared)))
        for frame in frames:
            if isinstance(frame, NotSent) or frame.key not in stored:
                yield frame
                continue
            digest = next(digests)
            there = stored[frame.key]
            if isinstance(digest, NotSent):
                yield digest
            elif digest == there.digest:
                yield AlreadyThere(frame.key, there.frame_id)
            else:
                yield frame

    def _outcomes(self, most: int) -> Iterator[Outcome]:
        """Outcomes so far; waits until at most so many batches are being sent."""
        while self._under_way > most or not self._finished.empty():
            try:
                # On Windows, Ctrl-C only interrupts a wait that has a time-out.
                finished = self._finished.get(timeout=_LISTEN_S)
            except Empty:
                continue
            if isinstance(finished, Future):
                self._under_way -= 1
                finished.result()
            else:
                yield finished

    def _send(self, batch: Batch) -> None:
        try:
            if not self._singly:
                self._sender().send(batch, self._finished.put)
                return
        except errors.NotFound:
            # An older server, or a deleted dataset: then each frame gets an error.
            self._singly = True
        for packed in batch:
            if self._stopped.is_set():
                return
            self._finished.put(self._put(packed.frame))

    def _put(self, frame: OutgoingFrame) -> Outcome:
        """One request for one frame."""
        try:
            call = frame_stored(self._path, frame, replace=self._replace)
            stored = self._transport.send(call)
        except (errors.ApiError, OSError, ValueError) as error:
            if _concerns_all(error):
                raise
            return NotSent(frame.key, error)
        return Sent(
            frame.key,
            stored.frame.id,
            stored.created,
            stored.frame.counts,
            stored.answers_set_aside,
            stored.boxes_set_aside,
            stored.notes,
        )

    def _sender(self) -> BatchSender:
        """The sender of this thread, created on first use."""
        if hasattr(self._of_thread, "sender"):
            existing: BatchSender = self._of_thread.sender
            return existing
        params = {"replace": self._replace or None}
        endpoint = self._transport.endpoint(f"{self._path}/batches", params)
        sender = BatchSender(endpoint, self._transport.retry, self._wait)
        self._of_thread.sender = sender
        self._all.append(sender)
        return sender

    def _wait(self, seconds: float) -> bool:
        return not self._stopped.wait(seconds) and not self._transport.closed


def _batches(
    items: Iterable[PackedFrame | AlreadyThere | NotSent],
) -> Iterator[Batch | AlreadyThere | NotSent]:
    """Groups frames into batches of limited size; outcomes are passed on."""
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


def _concerns_all(error: Exception) -> bool:
    """Whether all other frames would get this error of one frame as well.

    Not if a frame may not be replaced because of other people's answers.
    """
    if isinstance(error, errors.Forbidden):
        return error.code != "others_answers"
    return isinstance(
        error,
        (
            errors.Unauthorized,
            errors.NotFound,
            errors.Unavailable,
            errors.UnexpectedAnswer,
        ),
    )
