"""Stores the frames of a streamed archive while the rest is still being received."""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import AsyncIterator, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from typing import Final, TypeAlias

from anyio import CapacityLimiter, to_thread

from app.context import ServiceContext
from app.errors import AppError, NotReady, TooManyRequests
from app.incoming import HeldBytes, OpenBodies
from app.ingest.frame import (
    EndedFrame,
    PreparedFrame,
    ReadyFrame,
    UploadedFrame,
    UploadRequest,
)
from app.ingest.service import prepare_frame, store_frames
from app.ingest.tar import BLOCK, FrameAssembler, TarLimits, TarStream
from app.settings import Settings

MOST_TOGETHER: Final = 32
"""Maximum number of frames in one transaction."""
LONGEST_WAIT_S: Final = 0.1
"""How long a frame waits for others to share its transaction."""
MAX_IN_FLIGHT: Final = 96
"""Frames that are received but not reported yet; their images are on the disk."""
MAX_RECEIVED_BYTES: Final = 64 * 1024**2
"""Bytes of frames that are received but not measured yet; one frame may exceed it."""

_Started: TypeAlias = asyncio.Future[PreparedFrame]


class ArchiveFrames:
    """Frames of an archive that is being received; `held` counts bytes in memory."""

    def __init__(
        self, settings: Settings, chunks: AsyncIterator[bytes], held: HeldBytes
    ) -> None:
        self._chunks, self._held = chunks, held
        self._tar = TarStream(
            TarLimits(
                max_archive_bytes=int(settings.max_batch_bytes),
                max_member_bytes=int(settings.max_part_bytes),
                max_members=settings.max_batch_members,
            )
        )
        self._frames = FrameAssembler(settings)
        self._ready: deque[UploadedFrame] = deque()
        self._fault: Exception | None = None

    async def begin(self) -> None:
        """Read the first block, which shows whether this is an archive."""
        received = 0
        async for chunk in self._chunks:
            received += len(chunk)
            try:
                self._take(chunk)
            except AppError as fault:
                if not self._ready:
                    raise
                self._fault = fault  # raised after the frames before it
            if received >= BLOCK:
                return
        self._tar.close()

    async def __aiter__(self) -> AsyncIterator[UploadedFrame]:
        """Each frame as soon as it is complete; raises the archive's first fault."""
        for frame in self._given():
            yield frame
        if self._fault is not None:
            raise self._fault
        async for chunk in self._chunks:
            try:
                self._take(chunk)
            finally:
                # Frames that were complete before a fault are stored.
                for frame in self._given():
                    yield frame
        self._tar.close()
        for frame in self._frames.finish():
            yield frame

    def _take(self, chunk: bytes) -> None:
        for name, content in self._tar.feed(chunk):
            self._ready.extend(self._frames.add(name, content))
        self._held.hold(self._size_bytes)

    def _given(self) -> Iterator[UploadedFrame]:
        """Complete frames; the caller counts the bytes of each from then on."""
        while self._ready:
            frame = self._ready.popleft()
            # Raises nothing: after a fault, complete frames are still to be stored.
            self._held.lower_to(self._size_bytes)
            yield frame

    @property
    def _size_bytes(self) -> int:
        complete = sum(frame.size_bytes for frame in self._ready)
        return self._tar.size_bytes + self._frames.size_bytes + complete


class BatchIntake:
    """Measures frames in all threads, stores them in groups, and returns the results.

    The bytes of a frame count for the token of its sender until they are released, even
    if the batch has ended early.
    """

    def __init__(
        self, context: ServiceContext, request: UploadRequest, places: CapacityLimiter
    ) -> None:
        self._context, self._request, self._to_store = context, request, places
        self._started: asyncio.Queue[_Started | None] = asyncio.Queue()
        self._places = asyncio.Semaphore(MAX_IN_FLIGHT)
        self._room = _Room(MAX_RECEIVED_BYTES)
        self._held: _Started | None = None
        self._counted: deque[_CountedFrame] = deque()

    async def ended(
        self, frames: AsyncIterator[UploadedFrame]
    ) -> AsyncIterator[list[EndedFrame]]:
        """The result of each frame, in order, as soon as it is durable.

        Each list has the frames of one transaction. If reading the frames fails, the
        error is raised after the results of all frames before it.
        """
        receiving = asyncio.create_task(self._receive(frames))
        try:
            while prepared := await self._some():
                for together in _of_different_keys(prepared):
                    async with self._to_store:
                        ended = await to_thread.run_sync(
                            store_frames, self._context, self._request, together
                        )
                    yield ended
                    for _ in together:
                        self._places.release()
                        self._counted.popleft().release()
                # Free them while waiting for the next.
                prepared, together, ended = [], [], []
            await receiving
        finally:
            receiving.cancel()
            # Drafts of frames that are unfinished when the batch ends early.
            left = [self._held]
            while not self._started.empty():
                left.append(self._started.get_nowait())
            for started in left:
                if started is not None:
                    started.add_done_callback(self._discard)
            for counted in self._counted:
                counted.release()

    async def _receive(self, frames: AsyncIterator[UploadedFrame]) -> None:
        """Start measuring frames while there is room; otherwise let the client wait."""
        bodies = self._context.one(OpenBodies)
        prepare = partial(prepare_frame, self._context, self._request)
        try:
            async for frame in frames:
                if self._context.engine.stopping.is_set():
                    raise NotReady("the service is stopping; send the rest later")
                size = frame.size_bytes
                counted = _CountedFrame(bodies, size)
                try:
                    await self._places.acquire()
                    await self._room.take(size)
                    future = self._context.engine.start(prepare, frame)
                except BaseException:
                    counted.never_started()
                    raise
                future.add_done_callback(counted.measured)
                self._counted.append(counted)
                started = asyncio.wrap_future(future)
                started.add_done_callback(partial(self._room.give_back, size))
                self._started.put_nowait(started)
        finally:
            self._started.put_nowait(None)

    async def _some(self) -> list[PreparedFrame]:
        """The next frames that are ready at about the same time; empty at the end."""
        first = self._held or await self._started.get()
        self._held = None
        if first is None:
            return []
        prepared = [await first]
        until = asyncio.get_running_loop().time() + LONGEST_WAIT_S
        while len(prepared) < MOST_TOGETHER and not self._started.empty():
            following = self._started.get_nowait()
            if following is None:
                self._started.put_nowait(None)
                break
            left = until - asyncio.get_running_loop().time()
            await asyncio.wait({following}, timeout=max(left, 0.0))
            if not following.done() or following.exception() is not None:
                self._held = following
                break
            prepared.append(following.result())
        return prepared

    def _discard(self, future: asyncio.Future[PreparedFrame]) -> None:
        if future.cancelled() or future.exception() is not None:
            return
        frame = future.result()
        if isinstance(frame, ReadyFrame):
            self._context.storage.discard([frame.drafts])


class _CountedFrame:
    """Counts the bytes of a frame: all until it is measured, then what is needed."""

    def __init__(self, bodies: OpenBodies, size: int) -> None:
        bodies.take(size)
        self._bodies, self._size = bodies, size
        self._is_measured = self._is_released = False
        self._lock = threading.Lock()

    def measured(self, done: Future[PreparedFrame]) -> None:
        """Count only what is still needed; called in the thread that ends `done`."""
        failed = done.cancelled() or done.exception() is not None
        frame = None if failed else done.result()
        kept = frame.size_bytes if isinstance(frame, ReadyFrame) else 0
        with self._lock:
            self._is_measured = True
            self._lower(0 if self._is_released else kept)

    def release(self) -> None:
        """Release the frame's bytes: at once, or when a running measurement ends."""
        with self._lock:
            self._is_released = True
            if self._is_measured:
                self._lower(0)

    def never_started(self) -> None:
        """Release the bytes of a frame whose measurement was not started."""
        with self._lock:
            self._lower(0)

    def _lower(self, size: int) -> None:
        less = max(self._size - size, 0)
        self._size -= less
        self._bodies.give_back(less)


class _Room:
    """A budget of bytes, shared by the frames of a batch."""

    def __init__(self, size_bytes: int) -> None:
        self._free = size_bytes
        self._freed = asyncio.Event()

    async def take(self, size_bytes: int) -> None:
        """Wait until any bytes are free, then take this many."""
        while self._free <= 0:
            self._freed.clear()
            await self._freed.wait()
        self._free -= size_bytes

    def give_back(self, size_bytes: int, _done: object = None) -> None:
        """Return this many bytes."""
        self._free += size_bytes
        self._freed.set()


def _of_different_keys(prepared: list[PreparedFrame]) -> Iterator[list[PreparedFrame]]:
    """The frames in order, in groups in which no key occurs twice."""
    together: dict[str, PreparedFrame] = {}
    for work in prepared:
        if work.key in together:
            yield list(together.values())
            together = {}
        together[work.key] = work
    yield list(together.values())


_RETRY_S: Final = 5


class OpenBatches:
    """Counts the batches that are being received; used on the event loop only."""

    def __init__(self) -> None:
        self.open = 0

    @contextmanager
    def enter(self, settings: Settings) -> Iterator[None]:
        """Count one more batch during the block; TooManyRequests above the limit."""
        if self.open >= settings.max_open_batches:
            raise TooManyRequests(
                f"{self.open} batches are being received; send this one when one of "
                "them is done",
                retry_after_s=_RETRY_S,
            )
        self.open += 1
        try:
            yield
        finally:
            self.open -= 1
