"""Pieces of a file that is written later: in memory while small, else on disk."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import IO, Final

_IN_MEMORY: Final = 1024 * 1024

_PIECE: Final = 64 * 1024


class Spool:
    """Takes bytes now and gives them back in pieces; a context manager."""

    def __init__(self, folder: Path | None = None) -> None:
        place = None if folder is None else str(folder)
        self._file = tempfile.SpooledTemporaryFile(max_size=_IN_MEMORY, dir=place)  # noqa: SIM115  # closed by __exit__
        self._count = 0

    def __enter__(self) -> Spool:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()

    @property
    def count(self) -> int:
        """How many items were added."""
        return self._count

    @property
    def file(self) -> IO[bytes]:
        """The file behind it, for a library that wants one."""
        return self._file

    def write(self, piece: bytes) -> None:
        """Keep bytes."""
        self._file.write(piece)

    def add(self, value: object, *, by_key: bool = False) -> None:
        """Keep one more item of a JSON list, on a line of its own."""
        comma = b",\n" if self._count else b"\n"
        self._file.write(comma + json_bytes(value, by_key=by_key))
        self._count += 1

    def pieces(self) -> Iterator[bytes]:
        """Everything that was kept, from the start."""
        self._file.seek(0)
        while piece := self._file.read(_PIECE):
            yield piece


def json_bytes(value: object, *, by_key: bool = False) -> bytes:
    """Compact JSON; the same value always gives the same bytes.

    `by_key` sorts the keys of objects, for values whose keys came in any order.
    """
    text = json.dumps(
        value,
        ensure_ascii=False,
        separators=(",", ":"),
        allow_nan=False,
        sort_keys=by_key,
    )
    return text.encode("utf-8", "backslashreplace")
