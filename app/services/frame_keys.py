"""Keys of frames: names from users, never paths."""

from __future__ import annotations

import unicodedata

from app.errors import Unprocessable
from filter_core.formats.reading import MAX_KEY


def checked_key(key: str) -> str:
    """The key, if it can name a frame.

    Raises
    ------
    Unprocessable
        ``bad_key``: empty, too long, with control characters, or with parts that a
        file system would read as a way out of a folder.
    """
    fault = _fault(key)
    if fault:
        raise Unprocessable(
            f"key {key[:80]!r}: expected 1 to {MAX_KEY} characters such as "
            f"'town10/000012', found {fault}",
            code="bad_key",
        )
    return key


def _fault(key: str) -> str:
    parts = key.split("/")
    if not key or len(key) > MAX_KEY:
        return f"{len(key)} characters"
    if any(unicodedata.category(character).startswith("C") for character in key):
        return "a control character"
    if "\N{REPLACEMENT CHARACTER}" in key:
        # Of an address that is not UTF-8; keys that differ would become the same.
        return "a character that could not be read as UTF-8"
    if "" in parts:
        return "an empty part between slashes"
    if any(part in (".", "..") for part in parts) or "\\" in key:
        return "a part that leads out of a folder"
    return ""
