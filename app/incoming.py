"""Request bodies in memory: collected, limited, and large JSON parsed in turn."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from app.errors import NotReady, TooManyRequests

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

    def __init__(self, most: int, most_of_one: int) -> None:
        self._most, self._most_of_one = most, most_of_one
        self._by_token: Counter[int] = Counter()
        self._lock = threading.Lock()

    @property
    def open_bytes(self) -> int:
        """The bytes of all bodies that are held now."""
        with self._lock:
            return self._by_token.total()

    def take(self, token_id: int, size: int, *, held: int = 0) -> None:
        """Count `size` more bytes, for a request that already holds `held`.

        Raises TooManyRequests: this token's requests would exceed their limit;
        NotReady: all requests together would exceed theirs.
        """
        with self._lock:
            own, all_open = self._by_token[token_id], self._by_token.total()
            if own > held and own + size > self._most_of_one:
                raise TooManyRequests(
                    f"requests of this token hold {own} bytes already, expected at "
                    f"most {self._most_of_one} with this one; send it when others are "
                    "done",
                    retry_after_s=_RETRY_S,
                )
            if all_open > held and all_open + size > self._most:
                raise NotReady(
                    "the service holds as many bytes of requests as allowed; try again",
                    retry_after_s=_RETRY_S,
                )
            self._by_token[token_id] += size

    def give_back(self, token_id: int, size: int) -> None:
        """Release `size` bytes."""
        with self._lock:
            self._by_token[token_id] -= size
            if not self._by_token[token_id]:
                del self._by_token[token_id]


class HeldBytes:
    """The bytes that one request holds of its body; used on the event loop only.

    They are counted in `bodies`, for the token `token_id`.
    """

    def __init__(self, bodies: OpenBodies, token_id: int) -> None:
        self.bodies, self.token_id = bodies, token_id
        self._counted = 0

    def hold(self, size: int) -> None:
        """Set the number of bytes held to `size`; raises as `OpenBodies.take` does."""
        counted = size if size > UNCOUNTED_BYTES else 0
        more = counted - self._counted
        if more > 0:
            self.bodies.take(self.token_id, more, held=self._counted)
        elif more < 0:
            self.bodies.give_back(self.token_id, -more)
        self._counted = counted

    def lower_to(self, size: int) -> None:
        """Set the number of bytes held to `size`, if that is less than what counts."""
        if size < self._counted:
            self.hold(size)
