"""Large JSON is read one document after the other, whichever request it came with."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

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
