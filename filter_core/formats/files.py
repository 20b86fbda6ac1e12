"""Names of files in an export: a key is data from users and never a path."""

from __future__ import annotations

import hashlib
import unicodedata
from typing import Final
from urllib.parse import quote

_SAFE: Final = " ()[]{}+-=_.,;!@#$^&~'"

_RESERVED: Final = frozenset(
    {"con", "prn", "aux", "nul", "images", "labels"}
    | {f"{port}{number}" for port in ("com", "lpt") for number in range(1, 10)}
)
"""Names that Windows gives to devices, and those by which YOLO finds its labels."""

_FILE_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".txt", ".xml", ".json")
"""A folder that ends so could meet a file of the same name."""

_MAX_PART_BYTES: Final = 180
"""File systems allow 255 for one name; a suffix is still to come."""

_IN_PLACE_OF_SLASH: Final = "__"


def file_stem(key: str) -> str:
    """A frame's key as a path inside an export, different for every key.

    Keys come from users: whatever a file system or an unpacking tool could take for
    something else is written as ``%`` and its code. Sub-folders stay.
    """
    *folders, name = key.split("/")
    return "/".join([*map(_safe_folder, folders), _safe_part(name)])


class FileNames:
    """Stems that stay apart where a system takes capitals or accents for the same.

    Windows and macOS would unpack ``a`` over ``A``. The first in the order of the
    export keeps its name, any other gets a piece of its key's digest, so the same
    dataset always gives the same names. With `flat`, sub-folders become part of the
    name, since many readers do not look into them.
    """

    def __init__(self, *, flat: bool = False) -> None:
        self._flat = flat
        # Eight bytes each: a chance collision only renames a file needlessly.
        self._taken: set[int] = set()

    def stem(self, key: str) -> str:
        """The stem of one more frame."""
        stem = file_stem(key.replace("/", _IN_PLACE_OF_SLASH) if self._flat else key)
        if self._is_taken(stem):
            digest = hashlib.sha256(key.encode("utf-8", "surrogatepass")).hexdigest()
            folder, slash, name = stem.rpartition("/")
            stem = f"{folder}{slash}{name[:_MAX_PART_BYTES]}%~{digest[:16]}"
            self._is_taken(stem)
        return stem

    def _is_taken(self, stem: str) -> bool:
        """Whether it was there before; now it is."""
        alike = unicodedata.normalize("NFKC", stem.casefold()).casefold()
        digest = hashlib.sha256(alike.encode("utf-8", "surrogatepass")).digest()
        mark = int.from_bytes(digest[:8], "big")
        taken = mark in self._taken
        self._taken.add(mark)
        return taken


def _safe_folder(part: str) -> str:
    text = _safe_part(part)
    if text.lower().endswith(_FILE_SUFFIXES):
        head, _, suffix = text.rpartition(".")
        return f"{head}%2E{suffix}"
    return text


def _safe_part(part: str) -> str:
    letters = [
        letter if letter.isalnum() or letter in _SAFE else _escaped(letter)
        for letter in part
    ]
    # A leading dot hides a file; Windows drops a space or a dot at the end.
    for place in (0, -1):
        if letters and letters[place] in (" ", "."):
            letters[place] = f"%{ord(letters[place]):02X}"
    text = "".join(letters)
    if text.partition(".")[0].lower() in _RESERVED:
        return f"%{ord(text[0]):02X}{text[1:]}"
    if len(text.encode("utf-8", "surrogatepass")) > _MAX_PART_BYTES:
        digest = hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()
        text = f"{text[: _MAX_PART_BYTES // 6]}%~{digest[:32]}"
    return text or "%"


def _escaped(letter: str) -> str:
    return quote(letter, safe="", errors="surrogatepass")
