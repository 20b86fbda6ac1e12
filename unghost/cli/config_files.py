"""Configurations in files, and the file's name in whatever is wrong with them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from unghost.cli.exits import Refused
from unghost.errors import Invalid


def config_text(path: Path) -> str:
    """The text of a file, as it is sent to a server."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as exc:
        raise Refused(
            f"{path}: expected YAML in UTF-8, found other bytes at offset {exc.start}"
        ) from exc


@contextmanager
def naming(path: Path | None) -> Iterator[None]:
    """What is refused until the block ends is so because of this file.

    Raises
    ------
    Refused
        By the library here, or by the server.
    """
    from filter_core.errors import FilterError

    try:
        yield
    except (FilterError, Invalid) as exc:
        if path is None:
            raise
        raise Refused(f"{path}: {exc.detail}") from exc
