"""Frames of an archive that is being received, under the limit on bytes in memory."""

from collections.abc import AsyncIterator

import anyio
import pytest

from app.errors import NotReady
from app.incoming import HeldBytes, OpenBodies
from app.ingest.batch import ArchiveFrames
from app.settings import Settings
from tests.support.archives import frame, header_of, tar_without_end

MOST = 200_000


@pytest.mark.parametrize("begun", [b"", tar_without_end(frame("a"))[:512]])
def test_frame_that_is_complete_is_given_before_the_limit_is_raised(tmp_path, begun):
    """Also if one piece of the body completes a frame and exceeds the limit."""
    bodies = OpenBodies(MOST)
    bodies.take(MOST // 2)  # by another request
    archive = tar_without_end(frame("a") + frame("b"))
    archive += header_of("b.lidar.bin", MOST) + bytes(MOST - 512)
    pieces = [begun, archive[len(begun) :]] if begun else [archive]

    async def body() -> AsyncIterator[bytes]:
        for piece in pieces:
            yield piece

    keys = []

    async def receive() -> None:
        held = HeldBytes(bodies)
        frames = ArchiveFrames(Settings(data=tmp_path), body(), held)
        await frames.begin()
        try:
            async for each in frames:
                keys.append(each.key)
        finally:
            held.hold(0)

    with pytest.raises(NotReady):
        anyio.run(receive)
    assert keys == ["a"]
    assert bodies.open_bytes == MOST // 2
