"""A zip file whose bytes depend on nothing but what was put in."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Final

_EPOCH: Final = (1980, 1, 1, 0, 0, 0)
"""The earliest time a zip file can hold: no clock goes into an export."""
_PACKED: Final = (".png", ".jpg")
"""Compressed already: packing them again costs time and saves nothing."""
_READABLE: Final = 0o644 << 16


class ReproducibleZip:
    """Files in the order they were added, without times, owners or system names."""

    def __init__(self, path: Path) -> None:
        self._zip = zipfile.ZipFile(path, "w", allowZip64=True)

    def __enter__(self) -> ReproducibleZip:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._zip.close()

    def add(self, name: str, pieces: Iterable[bytes]) -> None:
        """Write a file piece by piece."""
        entry = zipfile.ZipInfo(name, _EPOCH)
        entry.create_system = 3  # Unix, wherever it is made
        entry.external_attr = _READABLE
        packed = name.endswith(_PACKED)
        entry.compress_type = zipfile.ZIP_STORED if packed else zipfile.ZIP_DEFLATED
        with self._zip.open(entry, "w", force_zip64=True) as file:
            for piece in pieces:
                file.write(piece)
