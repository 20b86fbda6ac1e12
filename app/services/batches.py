"""Many frames from one stream: stored and told while the rest still comes."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from functools import partial
from typing import Final

from anyio import CapacityLimiter, to_thread

from app.errors import AppError, NotReady
from app.services.batch_frames import FrameAssembler, FrameLimits, IncomingFrame
from app.services.batch_work import BatchOf, FrameLine, FrameWork, store, work_on
from app.services.context import ServiceContext
from app.services.tar_stream import BLOCK, TarLimits, TarStream
from app.settings import Settings

MOST_TOGETHER: Final = 32
"""Frames of one transaction."""
LONGEST_WAIT_S: Final = 0.1
"""How long a frame waits for others to share its transaction."""
MAX_IN_FLIGHT: Final = 96
"""Frames between being received and being told; their images are on the disk."""
MAX_RECEIVED_BYTES: Final = 64 * 1024**2
"""Bytes of frames that are received and not measured yet; one more frame fits."""

_Started = tuple[IncomingFrame, "asyncio.Future[FrameWork]"]


class ArchiveFrames:
    """Frames of an archive as its bytes come in."""

    def __init__(self, settings: Settings, chunks: AsyncIterator[bytes]) -> None:
        self._chunks = chunks
        self._first = b""
        self._tar = TarStream(
            TarLimits(
                max_archive_bytes=int(settings.max_batch_bytes),
                max_member_bytes=int(settings.max_part_bytes),
                max_members=settings.max_batch_members,
            )
        )
        self._frames = FrameAssembler(
            FrameLimits(
                max_parts=settings.max_parts,
                max_part_bytes=int(settings.max_part_bytes),
                max_frame_bytes=int(settings.max_body_bytes),
            )
        )
        self._ready: list[IncomingFrame] = []
        self._fault: Exception | None = None

    async def begin(self) -> None:
        """Read as much as shows that this is an archive at all."""
        received = 0
        async for chunk in self._chunks:
            received += len(chunk)
            try:
                self._take(chunk)
            except AppError as fault:
                if not self._ready:
                    raise
                self._fault = fault  # told after what came before it
            if received >= BLOCK:
                return
        self._tar.close()

    async def __aiter__(self) -> AsyncIterator[IncomingFrame]:
        """Each frame as soon as it is complete; what is wrong with the archive."""
        for frame in self._given():
            yield frame
        if self._fault is not None:
            raise self._fault
        async for chunk in self._chunks:
            try:
                self._take(chunk)
            finally:
                # What was complete before a fault is stored all the same.
                for frame in self._given():
                    yield frame
        self._tar.close()
        for frame in self._frames.finish():
            yield frame

    def _take(self, chunk: bytes) -> None:
        for member in self._tar.feed(chunk):
            self._ready.extend(self._frames.add(member))

    def _given(self) -> Iterator[IncomingFrame]:
        ready, self._ready = self._ready, []
        return iter(ready)


class BatchIntake:
    """Measures frames in all threads, stores some at a time, and tells of each."""

    def __init__(
        self, context: ServiceContext, batch: BatchOf, places: CapacityLimiter
    ) -> None:
        self._context, self._batch, self._to_store = context, batch, places
        self._started: asyncio.Queue[_Started | None] = asyncio.Queue()
        self._places = asyncio.Semaphore(MAX_IN_FLIGHT)
        self._room = _Room(MAX_RECEIVED_BYTES)
        self._held: _Started | None = None

    async def lines(
        self, frames: AsyncIterator[IncomingFrame]
    ) -> AsyncIterator[list[FrameLine]]:
        """What became of each frame, in their order, as soon as it is durable.

        Frames that share a transaction are durable, and told, together.

        Raises what ended the frames before their time, after all that came before.
        """
        receiving = asyncio.create_task(self._receive(frames))
        try:
            while works := await self._some():
                for together in _of_different_keys(works):
                    lines = await self._store(together)
                    yield lines
                    for _ in lines:
                        self._places.release()
            await receiving
        finally:
            receiving.cancel()
            self._throw_away()

    async def _receive(self, frames: AsyncIterator[IncomingFrame]) -> None:
        """Start work on frames while there is room; the client waits otherwise."""
        try:
            async for frame in frames:
                if self._context.engine.stopping.is_set():
                    raise NotReady("the service stops; send the rest again later")
                await self._places.acquire()
                size = frame.size_bytes
                await self._room.take(size)
                future = asyncio.wrap_future(
                    self._context.engine.start(self._work_on, frame)
                )
                future.add_done_callback(partial(self._room.give_back, size))
                self._started.put_nowait((frame, future))
        finally:
            self._started.put_nowait(None)

    def _work_on(self, frame: IncomingFrame) -> FrameWork:
        return work_on(self._context, self._batch, frame)

    async def _some(self) -> list[FrameWork]:
        """The next frames that are ready at about the same time; none at the end."""
        first = self._held or await self._started.get()
        self._held = None
        if first is None:
            return []
        works = [await first[1]]
        until = asyncio.get_running_loop().time() + LONGEST_WAIT_S
        while len(works) < MOST_TOGETHER and not self._started.empty():
            following = self._started.get_nowait()
            if following is None:
                self._started.put_nowait(None)
                break
            left = until - asyncio.get_running_loop().time()
            await asyncio.wait({following[1]}, timeout=max(left, 0.0))
            if not following[1].done() or following[1].exception() is not None:
                self._held = following
                break
            works.append(following[1].result())
        return works

    async def _store(self, works: list[FrameWork]) -> list[FrameLine]:
        async with self._to_store:
            return await to_thread.run_sync(store, self._context, self._batch, works)

    def _throw_away(self) -> None:
        """Drafts of frames that were on their way when the batch ended early."""
        left = [self._held]
        while not self._started.empty():
            left.append(self._started.get_nowait())
        for started in left:
            if started is not None:
                started[1].add_done_callback(self._discard)

    def _discard(self, future: asyncio.Future[FrameWork]) -> None:
        if future.cancelled() or future.exception() is not None:
            return
        drafts = future.result().drafts
        if drafts is not None:
            self._context.storage.discard([drafts])


class _Room:
    """Bytes that may be held; whoever needs more waits."""

    def __init__(self, size_bytes: int) -> None:
        self._free = size_bytes
        self._freed = asyncio.Event()

    async def take(self, size_bytes: int) -> None:
        """Wait until anything is free, and take this much."""
        while self._free <= 0:
            self._freed.clear()
            await self._freed.wait()
        self._free -= size_bytes

    def give_back(self, size_bytes: int, _done: object = None) -> None:
        """These are free again."""
        self._free += size_bytes
        self._freed.set()


def _of_different_keys(works: list[FrameWork]) -> Iterator[list[FrameWork]]:
    """In their order, cut wherever a key comes again."""
    together: dict[str, FrameWork] = {}
    for work in works:
        if work.key in together:
            yield list(together.values())
            together = {}
        together[work.key] = work
    yield list(together.values())
