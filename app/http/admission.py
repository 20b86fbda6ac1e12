"""How many requests of each kind one process works on at the same time.

All routes share 40 threads and the connections to the database. Requests above a limit
wait here without a thread.
"""

from __future__ import annotations

from typing import Final
from weakref import WeakValueDictionary

from anyio import CapacityLimiter

MAX_WRITERS: Final = 12
MAX_UPLOADS: Final = 8
MAX_BATCHES: Final = 4
"""Requests that write, upload a frame or send a batch; see `Admission`."""
MAX_FOLDERS: Final = 2
"""Dropped folders that are read, each by a child process."""
MAX_PARSERS: Final = 2
"""Large JSON bodies that are parsed."""
MAX_WRITES_PER_TOKEN: Final = 4
MAX_READS_PER_TOKEN: Final = 3
"""A list takes more of the processor than an answer: the more lists are at work, the
longer answers and uploads wait, and lists are not even faster."""


class TokenPlaces:
    """A limit on the concurrent requests of each token."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._of: WeakValueDictionary[int, CapacityLimiter] = WeakValueDictionary()

    def of(self, token_id: int) -> CapacityLimiter:
        """The limiter of one token; it is dropped when no request uses it any more."""
        places = self._of.get(token_id)
        if places is None:
            places = self._of[token_id] = CapacityLimiter(self._most)
        return places


class Admission:
    """The places of requests in a process; made on its event loop.

    Uploads have places of their own, so that answers of people need not wait for them.
    A token has few of the places for reading and writing, so that one person's lists
    and answers do not delay those of others.
    """

    def __init__(self, workers: int) -> None:
        """`workers` are those that measure images, and draw them."""
        self.uploads: Final = CapacityLimiter(MAX_UPLOADS + workers)
        self.drawings: Final = CapacityLimiter(workers + 1)
        self.writers: Final = CapacityLimiter(MAX_WRITERS)
        self.batches: Final = CapacityLimiter(MAX_BATCHES)
        self.folders: Final = CapacityLimiter(MAX_FOLDERS)
        self.parsers: Final = CapacityLimiter(MAX_PARSERS)
        self.drawing: Final = TokenPlaces(workers)  # one place is left for others
        self.reading: Final = TokenPlaces(MAX_READS_PER_TOKEN)
        self.writing: Final = TokenPlaces(MAX_WRITES_PER_TOKEN)
