"""How many batches of frames are being received at the same time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from app.errors import TooManyRequests

_RETRY_S: Final = 5


class OpenBatches:
    """How many batches are being received by this process; belongs to its loop."""

    def __init__(self) -> None:
        self._by_token: Counter[int] = Counter()

    @property
    def open(self) -> int:
        """How many there are."""
        return self._by_token.total()

    @contextmanager
    def enter(self, token_id: int, *, most: int, most_of_one: int) -> Iterator[None]:
        """A place for one more.

        Raises
        ------
        TooManyRequests
            As many are open already as may be, by all tokens or by this.
        """
        if self._by_token[token_id] >= most_of_one:
            raise TooManyRequests(
                f"{most_of_one} batches of this token are being received; send this "
                "one when one of them is done",
                retry_after_s=_RETRY_S,
            )
        if self.open >= most:
            raise TooManyRequests(
                f"{most} batches are being received; send this one when one of them "
                "is done",
                retry_after_s=_RETRY_S,
            )
        self._by_token[token_id] += 1
        try:
            yield
        finally:
            self._by_token[token_id] -= 1
            if not self._by_token[token_id]:
                del self._by_token[token_id]
