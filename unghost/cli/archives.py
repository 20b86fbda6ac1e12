"""Recordings in archives: unpacked into a temporary folder while a command runs.

An archive may come from anybody. Files are written first, so that none is written
through a link, and links only where they lead to something inside.
"""

from __future__ import annotations

import errno
import lzma
import os
import shutil
import stat
import struct
import tarfile
import zlib
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Final, Literal, NamedTuple, TypeAlias
from zipfile import BadZipFile, ZipFile, ZipInfo

from unghost.cli.screen import Refused, Screen, one_line

_TARS: Final = (".tar", ".tar.gz", ".tgz", ".tar.bz2", ".tbz2", ".tar.xz", ".txz")
ARCHIVE_SUFFIXES: Final = (".zip", *_TARS)

_ENCRYPTED: Final = 1
"""Bit of a ZIP member's flags."""
_MOST_OF_NAME: Final = 1 << 20
"""Bytes of a member's long name, link or other extended header."""
_PAX: Final = (tarfile.XHDTYPE, tarfile.XGLTYPE, tarfile.SOLARIS_XHDTYPE)
_EXTENDED: Final = (*_PAX, tarfile.GNUTYPE_LONGNAME, tarfile.GNUTYPE_LONGLINK)
_OF_FORMATS: Final = (BadZipFile, tarfile.TarError, zlib.error, lzma.LZMAError)
_OF_PYTHON: Final = (struct.error, EOFError, ValueError, NotImplementedError)
_DAMAGE: Final = (*_OF_FORMATS, *_OF_PYTHON, RuntimeError)
"""What the standard library raises for archives that it cannot read."""

_Kind: TypeAlias = Literal["file", "folder", "symbolic link", "hard link", "device"]


class _Member(NamedTuple):
    name: str
    kind: _Kind
    size: int
    open: Callable[[], IO[bytes] | None]
    target: str = ""
    """Of a link, as the archive has it."""


def is_archive(path: Path) -> bool:
    """Whether a file has the name of an archive that `unpacked` can unpack."""
    return path.name.lower().endswith(ARCHIVE_SUFFIXES) and path.is_file()


@contextmanager
def unpacked(archive: Path, screen: Screen) -> Iterator[Path]:
    """The recording of an archive in a temporary folder, which has the archive's name.

    It is that of the one folder at the top of the archive, else the whole content.

    Raises `Refused`: the archive is damaged or encrypted, does not fit on the disk, or
    has members outside of its folder, links out of it, or devices.
    """
    with TemporaryDirectory(prefix="unghost-") as temporary:
        content = Path(temporary, "content")
        content.mkdir()
        try:
            _unpack(archive, content, screen)
        except OSError as exc:
            if exc.errno in (errno.ENOSPC, errno.EDQUOT):
                raise _does_not_fit(archive, content) from exc
            if not exc.strerror:
                raise _damaged(archive, exc) from exc
            # Of a link the second is its own.
            path = exc.filename2 or exc.filename or archive
            name = Path(os.fsdecode(path)).name[:60]
            sentence = (
                f"{archive.name}: cannot be unpacked: {name}: {exc.strerror}; "
                "unpack it yourself, and give the folder"
            )
            raise Refused(one_line(sentence)) from exc
        except _DAMAGE as exc:
            raise _damaged(archive, exc) from exc
        recording = only_folder(content) or content
        yield recording.rename(Path(temporary, archive.name))


def only_folder(folder: Path) -> Path | None:
    """The one folder that a folder has at its top; None if there is more, or no folder.

    Hidden files are not counted, and a link is no folder.
    """
    from filter_core.formats.reading import is_hidden

    top = [path for path in folder.iterdir() if not is_hidden(path.name)]
    is_only = len(top) == 1 and top[0].is_dir() and not top[0].is_symlink()
    return top[0] if is_only else None


def _does_not_fit(archive: Path, folder: Path) -> Refused:
    return Refused(
        f"{archive.name}: does not fit unpacked on the disk of {folder.parent.parent}, "
        "where temporary files go; the variable TMPDIR names another folder"
    )


def _damaged(archive: Path, exc: Exception) -> Refused:
    reason = str(exc).partition("\n")[0].rstrip(":") or type(exc).__name__
    return Refused(
        one_line(
            f"{archive.name}: expected an archive, found a fault: {reason}; copy it "
            "again, or unpack it with another program and give the folder"
        )
    )


def _unpack(archive: Path, folder: Path, screen: Screen) -> None:
    links: list[_Member] = []
    free = shutil.disk_usage(folder).free
    is_zip = archive.name.lower().endswith(".zip")
    with (
        archive.open("rb") as file,
        screen.progress(f"unpack {archive.name}", "kB") as advance,
        closing(
            _zip_members(archive, file, folder) if is_zip else _tar_members(file)
        ) as members,
    ):
        total = -(-archive.stat().st_size // 1000)
        for member in members:
            path = folder / _inside(archive, member)
            if member.kind == "folder":
                path.mkdir(parents=True, exist_ok=True)
                continue
            path.parent.mkdir(parents=True, exist_ok=True)
            if member.kind != "file":
                links.append(member)
                continue
            free -= member.size
            if free < 0:
                raise _does_not_fit(archive, folder)
            content = member.open()
            assert content is not None, "a file has content"
            with content, path.open("wb") as copy:
                shutil.copyfileobj(content, copy, 1 << 20)
            # The last line comes at the end: the file is read ahead.
            advance(min(file.tell() // 1000, total - 1), total)
        _link(archive, folder, links)
        advance(total, total)


def _inside(archive: Path, member: _Member) -> Path:
    """The path of a member below the folder."""
    from filter_core.values import shown

    path = Path(member.name)
    if path.anchor or ".." in path.parts:
        raise Refused(
            f"{archive.name}: expected paths inside of the archive, found "
            f"{shown(member.name)}; make it anew from inside of the folder"
        )
    if member.kind == "device":
        raise Refused(
            f"{archive.name}: expected files, folders and links, found a device or a "
            f"pipe, {shown(member.name)}; make the archive without it"
        )
    return path


def _link(archive: Path, folder: Path, links: list[_Member]) -> None:
    """Make the links, when all files are there; one that leads nowhere is left out."""
    from filter_core.values import shown

    root = folder.resolve()
    symbolic = [link for link in links if link.kind == "symbolic link"]
    for link in links:
        if link.kind == "hard link":
            target = root / _inside(archive, link._replace(name=link.target))
            if target.is_file() and target != root / link.name:
                (root / link.name).unlink(missing_ok=True)
                os.link(target, root / link.name)
    for link in symbolic:
        (root / link.name).symlink_to(link.target)
    for link in symbolic:
        path = root / link.name
        target = _end_of(path, link.target)
        if not target.is_relative_to(root):
            raise Refused(
                f"{archive.name}: expected links inside of the archive, found "
                f"{shown(link.name)}, a link to {shown(link.target)}; make it anew "
                "with the files in place of links (tar --dereference)"
            )
        # Between folders as they are, since the one at the top gets another name.
        path.unlink()
        if target.exists():
            path.symlink_to(os.path.relpath(target, path.parent))


def _end_of(link: Path, target: str) -> Path:
    """Where a link leads, through other links; as far as its text says if nowhere."""
    try:
        return link.resolve(strict=True)
    except (OSError, RuntimeError):  # a loop is a RuntimeError before Python 3.13
        return Path(os.path.normpath(link.parent / target))


def _zip_members(
    archive: Path, file: IO[bytes], folder: Path
) -> Generator[_Member, None, None]:
    with ZipFile(file) as opened:
        members = opened.infolist()
        if any(member.flag_bits & _ENCRYPTED for member in members):
            raise Refused(
                f"{archive.name}: is encrypted; unpack it with its password, and give "
                "the folder"
            )
        if sum(info.file_size for info in members) > shutil.disk_usage(folder).free:
            raise _does_not_fit(archive, folder)
        for info in members:
            kind = _kind_in_zip(info)
            target = ""
            if kind == "symbolic link":
                with opened.open(info) as content:
                    target = os.fsdecode(content.read(_MOST_OF_NAME))
            yield _Member(
                info.filename, kind, info.file_size, partial(opened.open, info), target
            )


def _kind_in_zip(info: ZipInfo) -> _Kind:
    mode = info.external_attr >> 16
    if info.is_dir():
        return "folder"
    if stat.S_ISLNK(mode):
        return "symbolic link"
    return "file" if stat.S_IFMT(mode) in (0, stat.S_IFREG) else "device"


class _Header(tarfile.TarInfo):
    """A header that is not taken for the end of the archive where it is damaged."""

    @classmethod
    def frombuf(cls, buf: bytes | bytearray, encoding: str, errors: str) -> _Header:
        """The header of these bytes."""
        try:
            header = super().frombuf(buf, encoding, errors)
        except tarfile.HeaderError as exc:
            if len(buf) == tarfile.BLOCKSIZE and not any(buf):  # the mark of the end
                raise
            raise tarfile.ReadError(str(exc)) from exc
        if header.type in _EXTENDED and header.size > _MOST_OF_NAME:
            raise tarfile.ReadError("a header is too large")
        return header


def _tar_members(file: IO[bytes]) -> Generator[_Member, None, None]:
    with tarfile.open(fileobj=file, mode="r:*", tarinfo=_Header) as opened:
        while (info := opened.next()) is not None:
            # It would keep all of them in memory.
            vars(opened)["members"].clear()
            yield _Member(
                info.name,
                _kind_in_tar(info),
                info.size,
                partial(opened.extractfile, info),
                info.linkname,
            )


def _kind_in_tar(info: tarfile.TarInfo) -> _Kind:
    if info.isdir():
        return "folder"
    if info.issym():
        return "symbolic link"
    if info.islnk():
        return "hard link"
    return "file" if info.isreg() else "device"
