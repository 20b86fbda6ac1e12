"""How many batches of frames are being received at the same time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from app.errors import TooManyRequests

_RETRY_S: Final = 5


class OpenBatches:
    """How many batches are being received by this process."""

    def __init__(self) -> None:
        self._open = 0

    @property
    def open(self) -> int:
        """How many there are."""
        return self._open

    @contextmanager
    def enter(self, most: int) -> Iterator[None]:
        """A place for one more; TooManyRequests if there is none."""
        if self._open >= most:
            raise TooManyRequests(
                f"{most} batches are being received; send this one when one of them "
                "is done",
                retry_after_s=_RETRY_S,
            )
        self._open += 1
        try:
            yield
        finally:
            self._open -= 1
