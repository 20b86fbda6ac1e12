"""Files of an export: their names, their text, and temporary storage for it.

Keys of frames come from users: a file name made from a key never leads out of the
folder. A spool stores pieces that are written later, in memory or, if they are many, on
disk. `folder_sink` creates a folder only when it is complete, and `whole_file` a file.
"""

from __future__ import annotations

import hashlib
import html
import json
import os
import re
import shutil
import stat
import tempfile
import unicodedata
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import IO, Final
from urllib.parse import quote

from filter_core.formats.export import ExportError, Sink
from filter_core.formats.reading import name_of

_SAFE: Final = " ()[]{}+-=_.,;!@#$^&~'"

_RESERVED: Final = frozenset(
    {"con", "prn", "aux", "nul", "images", "labels", "classes"}
    | {f"{port}{number}" for port in ("com", "lpt") for number in range(1, 10)}
)
"""Names that Windows gives to devices, and those by which YOLO finds its labels and
readers find lists of classes."""

_FILE_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".txt", ".xml", ".json")
"""A folder that ends so could meet a file of the same name."""

_MAX_PART_BYTES: Final = 180
"""File systems allow 255 for one name; a suffix is still to come."""

_IN_PLACE_OF_SLASH: Final = "__"

_PIECE: Final = 64 * 1024

_NEW_FILE: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
"""With `O_EXCL` no link is followed, either."""

_IMPOSSIBLE: Final = re.compile(
    "[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]"
)
"""What XML 1.0 cannot hold, not even escaped."""


def file_stem(key: str) -> str:
    """A frame's key as a path inside an export, different for every key.

    Keys come from users: characters with a special meaning for a file system or an
    unpacking tool are written as ``%`` and their code. Sub-folders stay.
    """
    parts = [_safe_part(part) for part in key.split("/")]
    for place, folder in enumerate(parts[:-1]):
        if folder.lower().endswith(_FILE_SUFFIXES):
            head, _, suffix = folder.rpartition(".")
            parts[place] = f"{head}%2E{suffix}"
    return "/".join(parts)


class FileNames:
    """Makes stems that differ even on file systems that ignore case or accents.

    Windows and macOS would unpack ``a`` over ``A``. The first in the order of the
    export keeps its name, any other gets a part of its key's digest, so the same
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
        if not self._take(stem):
            digest = hashlib.sha256(key.encode("utf-8", "surrogatepass")).hexdigest()
            folder, slash, name = stem.rpartition("/")
            stem = f"{folder}{slash}{name[:_MAX_PART_BYTES]}%~{digest[:16]}"
            self._take(stem)
        return stem

    def _take(self, stem: str) -> bool:
        """Take a name; False if it was taken before."""
        alike = unicodedata.normalize("NFKC", stem.casefold()).casefold()
        digest = hashlib.sha256(alike.encode("utf-8", "surrogatepass")).digest()
        mark = int.from_bytes(digest[:8], "big")
        is_new = mark not in self._taken
        self._taken.add(mark)
        return is_new


@contextmanager
def folder_sink(folder: Path) -> Iterator[Sink]:
    """A sink that writes files into a `new_folder`.

    Raises `ExportError`: as `new_folder`; or a file's path leads out of it.
    """
    with new_folder(folder) as partial:

        def write(name: str, pieces: Iterable[bytes]) -> None:
            parts = PurePosixPath(name).parts
            if not parts or parts[0] == "/" or ".." in parts or "\\" in name:
                raise ExportError(
                    f"{name[:80]!r} is not a valid file name in an export"
                )
            path = partial.joinpath(*parts)
            path.parent.mkdir(parents=True, exist_ok=True)
            # Exclusive: a name that the system considers equal is not overwritten.
            with path.open("xb") as file:
                file.writelines(pieces)

        yield write


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """A folder to be filled, which appears under its name when everything is written.

    If anything fails, it does not appear. Raises `ExportError`: the folder exists
    already.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ExportError(f"{name_of(folder)}: expected a new or an empty folder")
    if folder.resolve() == Path.cwd():
        # It is created under another name first, and the current one cannot be moved.
        raise ExportError(f"{name_of(folder)}: expected a new folder, found this one")
    folder.parent.mkdir(parents=True, exist_ok=True)
    partial = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}-"))
    try:
        yield partial
        partial.chmod(0o755)
        if folder.exists():
            folder.rmdir()
        partial.rename(folder)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise


@contextmanager
def whole_file(path: Path, buffer_bytes: int = -1) -> Iterator[IO[bytes]]:
    """Write a file, which appears under its name when it is complete, not before.

    Until then it is a new file in the same folder, under a name that nobody can know:
    somebody else who fills the folder could have laid a link there to a private file.
    A link under the file's own name is replaced; a file there keeps its permissions. A
    device or a pipe of that name is written as it is.
    """
    is_device = path.exists() and not path.is_file()
    if is_device or path.is_relative_to("/dev"):  # /dev/stdout may lead to a file
        with path.open("wb", buffer_bytes) as device:
            yield device
        return
    draft = path.with_name(f".{os.urandom(8).hex()}.part")
    descriptor = os.open(draft, _NEW_FILE, 0o666)
    try:
        if path.is_file() and not path.is_symlink():
            draft.chmod(stat.S_IMODE(path.stat().st_mode))
        with os.fdopen(descriptor, "wb", buffer_bytes) as file:
            yield file
        draft.replace(path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise


def write_whole(path: Path, content: bytes) -> None:
    """Write a file as `whole_file` does."""
    with whole_file(path) as file:
        file.write(content)


class Spool:
    """Takes bytes now and gives them back in pieces; a context manager.

    Up to `buffer_bytes` are held in memory, more in a file in `folder`.
    """

    def __init__(self, folder: Path | None, buffer_bytes: int) -> None:
        place = None if folder is None else str(folder)
        self._file = tempfile.SpooledTemporaryFile(max_size=buffer_bytes, dir=place)  # noqa: SIM115  # closed by __exit__
        self._piece_bytes = min(_PIECE, buffer_bytes)
        self._count = 0

    def __enter__(self) -> Spool:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    @property
    def file(self) -> IO[bytes]:
        """The underlying file, for libraries that need one."""
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
        while piece := self._file.read(self._piece_bytes):
            yield piece


def json_bytes(value: object, *, by_key: bool = False) -> bytes:
    """Compact JSON; the same value always gives the same bytes.

    `by_key` sorts the keys of objects, for values whose keys came in any order.
    """
    encoder = _SORTED_JSON if by_key else _COMPACT_JSON
    return encoder.encode(value).encode("utf-8", "backslashreplace")


def number_text(value: float, *, most: int = 4) -> str:
    """The number with two decimals, as in KITTI, or up to so many if it has more."""
    # Adding zero takes the sign from a zero that was rounded.
    text = f"{round(value, most) + 0.0:.{most}f}"
    return text.rstrip("0").ljust(text.index(".") + 3, "0")


def element(name: str, value: object) -> str:
    """``<name>value</name>``."""
    return f"<{name}>{escaped(value)}</{name}>"


def escaped(value: object) -> str:
    """Text between tags; letters that XML cannot hold become U+FFFD."""
    return html.escape(_possible(value), quote=False)


def attributes(**values: object) -> str:
    """`` a="1" b="x"``, quoted."""
    # Not imported above, because it loads HTTP and TLS.
    from xml.sax.saxutils import quoteattr

    return "".join(
        f" {name}={quoteattr(_possible(value))}" for name, value in values.items()
    )


def _safe_part(part: str) -> str:
    letters = [
        letter
        if letter.isalnum() or letter in _SAFE
        else quote(letter, safe="", errors="surrogatepass")
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


# Made once: json.dumps makes one for each value that is not written in its own way.
_COMPACT_JSON, _SORTED_JSON = (
    json.JSONEncoder(
        ensure_ascii=False, separators=(",", ":"), allow_nan=False, sort_keys=sort_keys
    )
    for sort_keys in (False, True)
)


def _possible(value: object) -> str:
    return _IMPOSSIBLE.sub("\ufffd", str(value))
