"""Bytes of requests: held in pieces, counted, and large JSON parsed one at a time."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from app.errors import NotReady, TooManyRequests

_SMALL: Final = 1024
"""Pieces that are smaller on average are put together: each costs some 200 bytes."""


class Pieces:
    """What has arrived of something and was not asked for yet.

    Large pieces are kept as they are until somebody asks for the whole; a whole of one
    piece is not copied at all. Whoever sends byte by byte is held in little more memory
    than what was sent, for at most `_SMALL` bytes copied per piece.
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
"""Up to here a document is read in some milliseconds."""
_turn: Final = threading.Lock()


def is_large(size_bytes: int) -> bool:
    """Whether reading or writing JSON of this size holds up other threads."""
    return size_bytes > _LARGE_BYTES


@contextmanager
def in_turn(size_bytes: int) -> Iterator[None]:
    """Around reading or writing JSON of this size; waits, if it is large, for its turn.

    Python's parser lets no other thread run before it has read the whole document, and
    several at once would take turns with each other before the event loop has one: all
    requests would stand still for the sum of them.
    """
    if not is_large(size_bytes):
        yield
        return
    with _turn:
        yield


UNCOUNTED_BYTES: Final = 64 * 1024
"""Bodies up to here are not counted: answers of people go on while frames have to wait,
and the limit on connections bounds them."""
_RETRY_S: Final = 2


class OpenBodies:
    """Bytes that the bodies of this process hold; for any thread.

    A body that is larger than there is room for is taken all the same if there is none
    beside it: else it could never be sent.
    """

    def __init__(self, most: int, most_of_one: int) -> None:
        self._most, self._most_of_one = most, most_of_one
        self._by_token: Counter[int] = Counter()
        self._lock = threading.Lock()

    @property
    def open_bytes(self) -> int:
        """How many there are."""
        with self._lock:
            return self._by_token.total()

    def take(self, token_id: int, size: int, *, held: int = 0) -> None:
        """Count so many bytes more, for a request that holds some already.

        Raises
        ------
        TooManyRequests
            With them, this token would hold more than it may.
        NotReady
            With them, all together would.
        """
        with self._lock:
            mine, all_open = self._by_token[token_id], self._by_token.total()
            if mine > held and mine + size > self._most_of_one:
                raise TooManyRequests(
                    f"requests of this token hold {mine} bytes already, expected at "
                    f"most {self._most_of_one} with this one; send it when others are "
                    "done",
                    retry_after_s=_RETRY_S,
                )
            if all_open > held and all_open + size > self._most:
                raise NotReady(
                    "the service holds as many bytes of requests as it may; try again",
                    retry_after_s=_RETRY_S,
                )
            self._by_token[token_id] += size

    def give_back(self, token_id: int, size: int) -> None:
        """So many bytes are not held any more."""
        with self._lock:
            self._by_token[token_id] -= size
            if not self._by_token[token_id]:
                del self._by_token[token_id]


class HeldBytes:
    """What one request holds of its body; belongs to the event loop.

    `bodies` counts it, `token_id` is who sends it.
    """

    def __init__(self, bodies: OpenBodies, token_id: int) -> None:
        self.bodies, self.token_id = bodies, token_id
        self._counted = 0

    def hold(self, size: int) -> None:
        """Count so many bytes as held from now on; errors as of `OpenBodies.take`."""
        counted = size if size > UNCOUNTED_BYTES else 0
        more = counted - self._counted
        if more > 0:
            self.bodies.take(self.token_id, more, held=self._counted)
        elif more < 0:
            self.bodies.give_back(self.token_id, -more)
        self._counted = counted
