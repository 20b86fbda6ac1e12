"""Bytes that arrive in pieces: held as they came, copied once, and never more than once
over."""

from __future__ import annotations

from typing import Final

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
