"""Parses frames from a streamed tar archive, without writing files to disk.

An archive with links, devices or sparse files is refused, and so is a damaged or
truncated one. Python's `tarfile` does not guarantee that: its streaming mode accepts a
truncated archive, or one damaged after its first member; it reads a long name into
memory before its size can be checked; and it blocks a thread.
"""

from __future__ import annotations

import re
import tarfile
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

from app.errors import AppError, TooLarge, Unprocessable, UnsupportedMedia
from app.incoming import Pieces
from app.ingest.check import KINDS
from app.ingest.frame import UploadedFrame
from app.settings import Settings

_ANNOTATION: Final = ".json"


class FrameAssembler:
    """Groups members into frames; a frame is complete when the next one begins."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._open: UploadedFrame | None = None

    @property
    def size_bytes(self) -> int:
        """Bytes in memory of the frame that is not complete yet."""
        return self._open.size_bytes if self._open else 0

    def add(self, name: str, content: bytes | None) -> Iterator[UploadedFrame]:
        """The frames that this file completes; None is content that is too large."""
        if name.endswith(_ANNOTATION):
            yield from self.finish()
            key = name.removesuffix(_ANNOTATION)
            self._open = UploadedFrame(key, may_rename=True)
            self._take(self._open, "annotation", content)
        elif self._open and name.startswith(f"{self._open.key}."):
            suffixes = name[len(self._open.key) + 1 :]
            self._add_file(self._open, suffixes.partition(".")[0], content)
        else:
            first = "the NAME.json of its frame before it"
            expected = repr(f"{self._open.key}.KIND"[:80]) if self._open else first
            fault = Unprocessable(
                f"file {name[:80]!r} belongs to no frame; expected {expected}",
                code="misplaced_member",
            )
            yield UploadedFrame(name, fault=fault)

    def finish(self) -> Iterator[UploadedFrame]:
        """The last frame, if there is one."""
        done, self._open = self._open, None
        if done is not None:
            yield done

    def _add_file(self, frame: UploadedFrame, kind: str, content: bytes | None) -> None:
        most = self._settings.max_parts
        if kind not in KINDS:
            unknown = f"unknown part {kind[:80]!r}; expected {', '.join(KINDS)}"
            _refuse(frame, Unprocessable(unknown, code="unknown_part"))
        elif kind in frame.files:
            repeated = f"part {kind!r} was sent twice"
            _refuse(frame, Unprocessable(repeated, code="repeated_part"))
        elif len(frame.files) + 2 > most:
            _refuse(frame, TooLarge(f"the frame has more than {most} parts"))
        else:
            self._take(frame, kind, content)

    def _take(self, frame: UploadedFrame, part: str, content: bytes | None) -> None:
        most = int(self._settings.max_part_bytes)
        most_of_frame = int(self._settings.max_body_bytes)
        if content is None:
            _refuse(frame, TooLarge(f"part {part!r} is larger than {most} bytes"))
        elif frame.size_bytes + len(content) > most_of_frame:
            too_large = f"the frame is larger than {most_of_frame} bytes"
            _refuse(frame, TooLarge(too_large))
        elif frame.fault is None and part == "annotation":
            frame.annotation = content
        elif frame.fault is None:
            frame.files[part] = content


def _refuse(frame: UploadedFrame, fault: AppError) -> None:
    """Keep the first fault of a frame, and drop its content."""
    frame.fault = frame.fault or fault
    frame.annotation, frame.files = b"", {}


BLOCK: Final = 512
MAX_EXTENSION: Final = 64 * 1024
"""Maximum size of an extended header, which contains little more than a name."""

_LENGTH_DIGITS: Final = 6
"""Records of an extended header have lengths of at most five digits."""
_MOST_RECORDS: Final = 1000
"""Maximum number of records in an extended header; usual ones have a dozen."""
_SIZE: Final = re.compile(rb" *[0-7]* *(?:\0|$)|\x80", re.DOTALL)
"""Octal digits, or the first byte of a binary number of 95 bits."""
_HERE: Final = re.compile(r"(?:\./)*")

_FILE: Final = (b"0", b"\0", b"7")
_FOLDER: Final = b"5"
_PAX: Final = (b"x", b"g")
_LONG_NAME: Final = b"L"
_COMPRESSED: Final = {
    b"\x1f\x8b": "gzip",
    b"BZh": "bzip2",
    b"\xfd7zXZ": "xz",
    b"\x28\xb5\x2f\xfd": "zstd",
}
_KINDS: Final = {
    b"1": "a link",
    b"2": "a symbolic link",
    b"3": "a device",
    b"4": "a device",
    b"6": "a pipe",
    b"K": "a link",
    b"S": "a sparse file",
}


class BadArchive(Unprocessable):
    """The archive cannot be read, or has members that frames cannot have."""

    code = "bad_archive"


@dataclass(frozen=True)
class TarLimits:
    """Limits on the size of an archive."""

    max_archive_bytes: int
    max_member_bytes: int
    max_members: int


class _Header(NamedTuple):
    name: bytes
    size: int
    kind: bytes


class TarStream:
    """An incremental parser: takes bytes as they arrive, returns complete files.

    A name that leads out of the archive is refused, unless `any_name` is true: then the
    caller has to check names.
    """

    def __init__(self, limits: TarLimits, *, any_name: bool = False) -> None:
        self._limits, self._any_name = limits, any_name
        self._held = Pieces()
        self._missing = BLOCK
        self._ignored = 0
        self._header: _Header | None = None
        self._long_name: bytes | None = None
        self._members = 0
        self._zero_blocks = 0

    @property
    def is_whole(self) -> bool:
        """True once the end of the archive has been seen."""
        return self._zero_blocks >= 2

    @property
    def size_bytes(self) -> int:
        """Bytes in memory of the member that is not complete yet."""
        return len(self._held)

    def feed(self, data: bytes) -> Iterator[tuple[str, bytes | None]]:
        """The names and contents of the files that are completed by these bytes.

        The content is None if the file is larger than allowed.

        Raises BadArchive: the archive is damaged, or has members that are neither files
        nor folders; UnsupportedMedia: it is compressed; TooLarge: a member is too large
        for any batch, or there are too many members.
        """
        view = memoryview(data)
        while view:
            if self._ignored:
                dropped = view[: self._ignored]
                view = view[len(dropped) :]
                self._ignored -= len(dropped)
                continue
            taken = view[: self._missing]
            view = view[len(taken) :]
            self._missing -= len(taken)
            self._held += taken
            if self._missing == 0:  # a header, or the content of a member
                block, self._held = bytes(self._held), Pieces()
                header, self._header = self._header, None
                self._missing = BLOCK
                if header is None:
                    yield from self._begin(block)
                else:
                    self._ignored = -header.size % BLOCK
                    yield from self._end(header, block)

    def close(self) -> None:
        """End the input; raises BadArchive if the archive is truncated."""
        if not self.is_whole:
            raise BadArchive(
                "the archive is truncated: expected two empty blocks at its end"
            )

    def _begin(self, block: bytes) -> Iterator[tuple[str, bytes | None]]:
        if not block.strip(b"\0"):
            self._zero_blocks += 1
            return
        if self._zero_blocks:
            raise BadArchive("the archive has data after its end")
        header = _read_header(block, first=self._members == 0)
        # Old archives mark a folder only by a final slash. A long name is considered as
        # a whole: the header has only its start.
        name = header.name if self._long_name is None else self._long_name
        looks_so = header.kind in (b"0", b"\0") and name.endswith(b"/")
        if looks_so or header.kind == _FOLDER:
            header = _Header(header.name, 0, _FOLDER)
        self._members += 1
        self._check(header)
        if header.size > self._limits.max_member_bytes:
            self._ignored = header.size + -header.size % BLOCK
            yield from self._end(header, None)
        elif header.size == 0:
            yield from self._end(header, b"")
        else:
            self._header, self._missing = header, header.size

    def _end(
        self, header: _Header, content: bytes | None
    ) -> Iterator[tuple[str, bytes | None]]:
        if header.kind in _FILE:
            name = header.name if self._long_name is None else self._long_name
            yield _decoded_name(name, any_name=self._any_name), content
        elif header.kind == _LONG_NAME:
            self._long_name = (content or b"").split(b"\0", 1)[0]
            return
        elif header.kind != _FOLDER:
            records = dict(_pax_records(content or b""))
            is_sparse = any(key.startswith("GNU.sparse") for key in records)
            if is_sparse or "size" in records:
                raise BadArchive("an extended header changes the size of a member")
            self._long_name = records.get("path") if header.kind == b"x" else None
            return
        self._long_name = None

    def _check(self, header: _Header) -> None:
        limits = self._limits
        if self._members > limits.max_members:
            raise TooLarge(f"the archive has more than {limits.max_members} members")
        if header.size > limits.max_archive_bytes:
            raise TooLarge(
                f"a member has {header.size} bytes; "
                f"expected an archive of at most {limits.max_archive_bytes}"
            )
        if header.kind not in (*_FILE, *_PAX, _FOLDER, _LONG_NAME):
            kind = _KINDS.get(header.kind, f"an entry of type {header.kind!r}")
            name = (self._long_name or header.name)[:80].decode("utf-8", "replace")
            raise BadArchive(f"{name!r}: expected a file or a folder, found {kind}")
        is_extension = header.kind in (*_PAX, _LONG_NAME)
        if is_extension and header.size > MAX_EXTENSION:
            raise BadArchive(
                f"an extended header of {header.size} bytes; "
                f"expected at most {MAX_EXTENSION}"
            )


def _read_header(block: bytes, *, first: bool) -> _Header:
    if first:
        for magic, program in _COMPRESSED.items():
            if block.startswith(magic):
                raise UnsupportedMedia(
                    f"the archive is compressed by {program}; expected a plain tar"
                )
    try:
        info = tarfile.TarInfo.frombuf(block, "utf-8", "surrogateescape")
    except tarfile.HeaderError as error:
        raise BadArchive(
            "a header of the archive is damaged, or this is not a tar"
        ) from error
    name = info.name.encode("utf-8", "surrogateescape")
    if not _SIZE.match(block, 124, 136):
        raise BadArchive(
            f"the size of {name[:80].decode('utf-8', 'replace')!r}: expected octal "
            f"digits or a positive binary number, found {block[124:136]!r}"
        )
    # A folder of an old archive has the type of a file.
    kind = _FOLDER if info.isdir() else block[156:157]
    return _Header(name, info.size, kind)


def _pax_records(content: bytes) -> Iterator[tuple[str, bytes]]:
    """The keys and values of records, each ``LENGTH KEY=VALUE`` and a line feed."""
    position = records = 0
    while position < len(content):
        records += 1
        length, _, _ = content[position : position + _LENGTH_DIGITS].partition(b" ")
        size = int(length) if length.isdigit() and len(length) < _LENGTH_DIGITS else 0
        record = content[position : position + size]
        key, equals, value = record[len(length) + 1 : -1].partition(b"=")
        is_whole = size > 0 and equals == b"=" and record.endswith(b"\n")
        if records > _MOST_RECORDS or not is_whole:
            raise BadArchive("an extended header of the archive is damaged")
        yield key.decode("utf-8", "replace"), value
        position += size


def _decoded_name(raw: bytes, *, any_name: bool) -> str:
    try:
        name = _HERE.sub("", raw.decode("utf-8"), count=1)
    except UnicodeDecodeError as error:
        raise BadArchive(f"the name {raw[:80]!r} is not UTF-8") from error
    leads_out = name.startswith("/") or ".." in name.split("/") or "\\" in name
    is_refused = not name or leads_out or "\0" in name or name[1:2] == ":"
    if is_refused and not any_name:
        raise BadArchive(
            f"the name {name[:80]!r}; expected one that stays within the archive"
        )
    return name
