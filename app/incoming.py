"""Request bodies in memory: collected, limited, and large JSON parsed in turn."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from app.errors import NotReady

_SMALL: Final = 1024
"""Pieces that are smaller on average are joined: each object costs some 200 bytes."""


class Pieces:
    """A buffer of received bytes that have not been read yet.

    Large pieces are joined only when the whole is read, and a single piece of `bytes`
    is never copied. A client that sends byte by byte needs little more memory than it
    has sent; each of its pieces costs at most `_SMALL` bytes of copying.
    """

    def __init__(self) -> None:
        self._pieces: list[bytes | memoryview] = []
        self._size = 0

    def __iadd__(self, piece: bytes | memoryview) -> Pieces:
        self._pieces.append(piece)
        self._size += len(piece)
        if len(self._pieces) > 64 and self._size < len(self._pieces) * _SMALL:
            self._pieces = [b"".join(self._pieces)]
        return self

    def __len__(self) -> int:
        return self._size

    def __bytes__(self) -> bytes:
        only = self._pieces[0] if len(self._pieces) == 1 else b"".join(self._pieces)
        return bytes(only)


_LARGE_BYTES: Final = 256 * 1024
"""Documents up to this size are parsed in a few milliseconds."""
_turn: Final = threading.Lock()


def is_large(size_bytes: int) -> bool:
    """Whether parsing or writing JSON of this size blocks other threads noticeably."""
    return size_bytes > _LARGE_BYTES


@contextmanager
def in_turn(size_bytes: int) -> Iterator[None]:
    """Parse or write JSON of this size in the block: large documents one at a time.

    Python's parser holds the interpreter lock (GIL) for a whole document. If several
    threads parsed at once, each could get the lock before the event loop does, and all
    requests would stall for the sum of their times.
    """
    if not is_large(size_bytes):
        yield
        return
    with _turn:
        yield


UNCOUNTED_BYTES: Final = 64 * 1024
"""Bodies up to this size are not counted, so that people can review while uploads have
to wait; the limit on connections bounds how many there are."""
_RETRY_S: Final = 2


class OpenBodies:
    """Counts the bytes of the request bodies in this process; thread-safe.

    A body above a limit is accepted while no other is held: otherwise it could never be
    sent.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self.open_bytes = 0
        self._lock = threading.Lock()

    def take(self, size: int, *, held: int = 0) -> None:
        """Count `size` more bytes, for a request that already holds `held`.

        Raises NotReady: all requests together would exceed the limit.
        """
        with self._lock:
            if self.open_bytes > held and self.open_bytes + size > self._most:
                raise NotReady(
                    "the service holds as many bytes of requests as allowed; try again",
                    retry_after_s=_RETRY_S,
                )
            self.open_bytes += size

    def give_back(self, size: int) -> None:
        """Release `size` bytes."""
        with self._lock:
            self.open_bytes -= size


class HeldBytes:
    """The bytes that one request holds of its body; used on the event loop only."""

    def __init__(self, bodies: OpenBodies) -> None:
        self._bodies = bodies
        self._counted = 0

    def hold(self, size: int) -> None:
        """Set the number of bytes held to `size`; raises as `OpenBodies.take` does."""
        counted = size if size > UNCOUNTED_BYTES else 0
        more = counted - self._counted
        if more > 0:
            self._bodies.take(more, held=self._counted)
        elif more < 0:
            self._bodies.give_back(-more)
        self._counted = counted

    def lower_to(self, size: int) -> None:
        """Set the number of bytes held to `size`, if that is less than what counts."""
        if size < self._counted:
            self.hold(size)
