"""Frames out of a tar archive that arrives in pieces; nothing is unpacked to a path.

An archive with links, devices or sparse files is refused, and so is one that is damaged
or cut short. Python's `tarfile` does not promise that: in its streaming mode it takes
an archive without an end, or one damaged after its first member, as if it were whole;
it reads a long name into memory before a limit can stand; and it blocks a thread.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from app.errors import AppError, TooLarge, Unprocessable, UnsupportedMedia
from app.incoming import Pieces
from app.ingest.check import KINDS
from app.ingest.frame import UploadedFrame

_ANNOTATION: Final = ".json"


@dataclass(frozen=True)
class FrameLimits:
    """What one frame may be at most."""

    max_parts: int
    max_part_bytes: int
    max_frame_bytes: int


class FrameAssembler:
    """Gives each frame when the next one begins, or the archive ends."""

    def __init__(self, limits: FrameLimits) -> None:
        self._limits = limits
        self._open: UploadedFrame | None = None

    @property
    def size_bytes(self) -> int:
        """What the frame that is not complete yet holds in memory."""
        return self._open.size_bytes if self._open else 0

    def add(self, member: Member) -> Iterator[UploadedFrame]:
        """The frames that this member completes."""
        if member.name.endswith(_ANNOTATION):
            yield from self.finish()
            self._open = UploadedFrame(
                member.name.removesuffix(_ANNOTATION), may_rename=True
            )
            self._take(self._open, "annotation", member.content)
        elif self._open and member.name.startswith(f"{self._open.key}."):
            suffixes = member.name[len(self._open.key) + 1 :]
            self._add_file(self._open, suffixes.partition(".")[0], member.content)
        else:
            yield UploadedFrame(member.name, fault=self._misplaced(member.name))

    def finish(self) -> Iterator[UploadedFrame]:
        """The last frame."""
        done, self._open = self._open, None
        if done is not None:
            yield done

    def _misplaced(self, name: str) -> Unprocessable:
        first = "the NAME.json of its frame before it"
        expected = repr(f"{self._open.key}.KIND"[:80]) if self._open else first
        return Unprocessable(
            f"file {name[:80]!r} belongs to no frame; expected {expected}",
            code="misplaced_member",
        )

    def _add_file(self, frame: UploadedFrame, kind: str, content: bytes | None) -> None:
        if kind not in KINDS:
            _refuse(
                frame,
                Unprocessable(
                    f"unknown part {kind[:80]!r}; expected {', '.join(KINDS)}",
                    code="unknown_part",
                ),
            )
        elif kind in frame.files:
            repeated = f"part {kind!r} was sent twice"
            _refuse(frame, Unprocessable(repeated, code="repeated_part"))
        elif len(frame.files) + 2 > self._limits.max_parts:
            most = self._limits.max_parts
            _refuse(frame, TooLarge(f"the frame has more than {most} parts"))
        else:
            self._take(frame, kind, content)

    def _take(self, frame: UploadedFrame, part: str, content: bytes | None) -> None:
        limits = self._limits
        if content is None:
            most = limits.max_part_bytes
            _refuse(frame, TooLarge(f"part {part!r} is larger than {most} bytes"))
        elif frame.size_bytes + len(content) > limits.max_frame_bytes:
            most = limits.max_frame_bytes
            _refuse(frame, TooLarge(f"the frame is larger than {most} bytes"))
        elif frame.fault is None and part == "annotation":
            frame.annotation = content
        elif frame.fault is None:
            frame.files[part] = content


def _refuse(frame: UploadedFrame, fault: AppError) -> None:
    """The first fault is what is told; nothing of the frame is kept."""
    frame.fault = frame.fault or fault
    frame.annotation, frame.files = b"", {}


BLOCK: Final = 512
MAX_EXTENSION: Final = 64 * 1024
"""Bytes of an extended header: a name, and little else."""

_LENGTH_DIGITS: Final = 6
"""No record of an extended header is longer than five digits can say."""
_MOST_RECORDS: Final = 1000
"""Of one extended header; those that programs write have a dozen."""
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
    """The archive cannot be read, or has what no archive of frames has."""

    code = "bad_archive"


@dataclass(frozen=True)
class TarLimits:
    """What an archive may be at most."""

    max_archive_bytes: int
    max_member_bytes: int
    max_members: int


@dataclass(frozen=True)
class Member:
    """A file of an archive; `content` is None if it is larger than allowed."""

    name: str
    content: bytes | None


@dataclass(frozen=True)
class _Header:
    name: bytes
    size: int
    kind: bytes


class TarStream:
    """Feed it bytes as they come; it gives the files that are complete.

    A name that leads out of the archive is refused, unless `any_name`: then whoever
    takes the members looks at their names.
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
        """What has come of a member that is not complete yet."""
        return len(self._held)

    def feed(self, data: bytes) -> Iterator[Member]:
        """The files that end within these bytes.

        Raises
        ------
        BadArchive
            It is damaged, or has members that are neither files nor folders.
        UnsupportedMedia
            It is compressed.
        TooLarge
            A size that no batch may have, or more members than allowed.
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
            if self._missing == 0:
                yield from self._complete()

    def close(self) -> None:
        """No more bytes come; BadArchive unless the archive is whole."""
        if not self.is_whole:
            raise BadArchive(
                "the archive is cut short: expected two empty blocks at its end"
            )

    def _complete(self) -> Iterator[Member]:
        """A header, or what a header announced, is complete."""
        block, self._held = bytes(self._held), Pieces()
        header, self._header = self._header, None
        self._missing = BLOCK
        if header is None:
            yield from self._begin(block)
            return
        self._ignored = -header.size % BLOCK
        yield from self._end(header, block)

    def _begin(self, block: bytes) -> Iterator[Member]:
        if not block.strip(b"\0"):
            self._zero_blocks += 1
            return
        if self._zero_blocks:
            raise BadArchive("the archive goes on after its end")
        header = _read_header(block, first=self._members == 0)
        if self._is_folder(header):
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

    def _is_folder(self, header: _Header) -> bool:
        """A name in the header itself is cut, perhaps behind a slash."""
        name = header.name if self._long_name is None else self._long_name
        looks_so = header.kind in (b"0", b"\0") and name.endswith(b"/")
        return looks_so or header.kind == _FOLDER

    def _end(self, header: _Header, content: bytes | None) -> Iterator[Member]:
        if header.kind in _FILE:
            name = header.name if self._long_name is None else self._long_name
            named = _decoded_name(name)
            if not self._any_name:
                _refuse_way_out(named)
            yield Member(named, content)
        elif header.kind != _FOLDER:
            self._long_name = _extension(header, content or b"")
            return
        self._long_name = None

    def _check(self, header: _Header) -> None:
        limits = self._limits
        if self._members > limits.max_members:
            raise TooLarge(f"the archive has more than {limits.max_members} members")
        if header.size > limits.max_archive_bytes:
            raise TooLarge(
                f"a member says that it has {header.size} bytes; "
                f"expected an archive of at most {limits.max_archive_bytes}"
            )
        known = (*_FILE, *_PAX, _FOLDER, _LONG_NAME)
        if header.kind not in known:
            found = _KINDS.get(header.kind, f"an entry of type {header.kind!r}")
            name = (self._long_name or header.name)[:80].decode("utf-8", "replace")
            raise BadArchive(f"{name!r}: expected a file or a folder, found {found}")
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
    if not _is_sound(block):
        raise BadArchive("a header of the archive is damaged, or this is no tar")
    name = block[:100].split(b"\0", 1)[0]
    if block[257:263] == b"ustar\0":
        prefix = block[345:500].split(b"\0", 1)[0]
        name = prefix + b"/" + name if prefix else name
    size = _number(block[124:136])
    if size is None:
        raise BadArchive(
            f"the size of {name[:80].decode('utf-8', 'replace')!r}: expected octal "
            f"digits or a positive binary number, found {block[124:136]!r}"
        )
    return _Header(name, size, block[156:157])


def _is_sound(block: bytes) -> bool:
    """The sum of all bytes but its own, as unsigned or, as some wrote it, signed."""
    rest = block[:148] + b" " * 8 + block[156:]
    found, unsigned = _number(block[148:156]), sum(rest)
    return found == unsigned or found == unsigned - 256 * sum(one > 127 for one in rest)


def _number(field: bytes) -> int | None:
    """Octal digits, or for large sizes a number of 95 bits; None if it is neither.

    A first byte of 0xFF would begin a negative number, which nothing here can be.
    """
    if field[0] == 0x80:
        return int.from_bytes(field[1:], "big")
    digits = field.split(b"\0", 1)[0].strip(b" ")
    return None if digits.strip(b"01234567") else int(digits or b"0", 8)


def _extension(header: _Header, content: bytes) -> bytes | None:
    """The name that an extended header gives the next member."""
    if header.kind == _LONG_NAME:
        return content.split(b"\0", 1)[0]
    records = dict(_pax_records(content))
    if "size" in records or any(key.startswith("GNU.sparse") for key in records):
        raise BadArchive("an extended header changes the size of a member")
    return records.get("path") if header.kind == b"x" else None


def _pax_records(content: bytes) -> Iterator[tuple[str, bytes]]:
    """``LENGTH KEY=VALUE`` and a line end, one after the other."""
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


def _decoded_name(raw: bytes) -> str:
    try:
        name = raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise BadArchive(f"the name {raw[:80]!r} is not UTF-8") from error
    return _HERE.sub("", name, count=1)


def _refuse_way_out(name: str) -> None:
    parts = name.split("/")
    leads_out = name.startswith("/") or ".." in parts or "\\" in name
    if not name or leads_out or "\0" in name or name[1:2] == ":":
        raise BadArchive(
            f"the name {name[:80]!r}; expected one that stays within the archive"
        )
