"""What a backup consists of, and reading one: each part checked while it passes."""

from __future__ import annotations

import hashlib
import json
import re
import sqlite3
import tarfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Final

from app.db.inspection import problems_of, wanted_files
from app.services.data_folder import Advance, CannotMaintain
from app.storage import BLOBS

FORMAT: Final = 1
LABEL: Final = "backup.json"
DATABASE: Final = "unghost.db"
_BLOB: Final = re.compile(rf"{BLOBS}/([0-9a-f]{{2}})/(\1[0-9a-f]{{62}})")
_CHUNK: Final = 1 << 20
_MB: Final = 10**6


@dataclass(frozen=True)
class BackupLabel:
    """What stands on a backup."""

    format: int
    version: str
    schema: str
    created_at: str
    files: int
    database_sha256: str
    left_out: tuple[str, ...] = ()

    def text(self) -> str:
        """As it is written."""
        return json.dumps(asdict(self), indent=2) + "\n"


@dataclass(frozen=True)
class Unpacked:
    """A backup that was read to its end, and is whole."""

    label: BackupLabel
    files: int


def blob_name(digest: str) -> str:
    """Where a blob lies in a backup."""
    return f"{BLOBS}/{digest[:2]}/{digest}"


def unpack(backup: Path, folder: Path, advance: Advance, *, keep: bool) -> Unpacked:
    """Read a backup into a folder, or only its database if the rest is not to be kept.

    Raises
    ------
    CannotMaintain
        It is no backup, or not whole; what is wrong with it is said.
    """
    digests: dict[str, str] = {}
    label, done, total = None, 0, size_of(backup)
    with _parts(backup) as parts:
        for name, stream in parts:
            if name == LABEL:
                # It comes last: only then is known what was left out.
                label = _label(stream.read(), backup)
                continue
            target = folder / name if keep or name == DATABASE else None
            digests[name] = _copy(stream, target)
            if name != DATABASE and not name.endswith(digests[name]):
                raise CannotMaintain(
                    f"{backup} is damaged: {name} is not what was stored"
                )
            done += stream.tell()
            advance(done // _MB, total // _MB)
    if label is None:
        raise CannotMaintain(f"{backup} is no backup: it has no {LABEL}")
    if digests.pop(DATABASE, None) != label.database_sha256:
        raise CannotMaintain(
            f"{backup} is damaged: its database is not what was copied"
        )
    _check_complete(backup, folder / DATABASE, set(digests), label)
    return Unpacked(label, len(digests))


def _label(content: bytes, backup: Path) -> BackupLabel:
    try:
        found = json.loads(content)
        label = BackupLabel(**{**found, "left_out": tuple(found["left_out"])})
    except (ValueError, TypeError, KeyError) as exc:
        raise CannotMaintain(f"{backup}: its {LABEL} cannot be read") from exc
    if label.format != FORMAT:
        raise CannotMaintain(
            f"{backup} has format {label.format}, this version reads {FORMAT}"
        )
    return label


def _check_complete(
    backup: Path, database: Path, names: set[str], label: BackupLabel
) -> None:
    try:
        problems = problems_of(database)
        wanted = wanted_files(database)
    except sqlite3.DatabaseError as exc:
        raise CannotMaintain(f"{backup}: its database cannot be read: {exc}") from exc
    if problems:
        raise CannotMaintain(f"{backup}: its database is damaged: {problems[0]}")
    missing = {blob_name(digest) for digest in wanted - {*label.left_out}} - names
    if missing:
        raise CannotMaintain(
            f"{backup} is not complete: {len(missing)} files are missing, one is "
            f"{min(missing)}"
        )


@contextmanager
def _parts(backup: Path) -> Iterator[Iterator[tuple[str, IO[bytes]]]]:
    if backup.is_dir():
        yield _folder_parts(backup)
        return
    try:
        with tarfile.open(backup, "r:") as archive:
            yield _tar_parts(backup, archive)
    except (tarfile.TarError, EOFError) as exc:
        raise CannotMaintain(f"{backup} is no backup, or cut off: {exc}") from exc


def _tar_parts(
    backup: Path, archive: tarfile.TarFile
) -> Iterator[tuple[str, IO[bytes]]]:
    for member in archive:
        stream = archive.extractfile(member) if member.isfile() else None
        if stream is None or not _is_part(member.name):
            raise CannotMaintain(
                f"{backup} is no backup: {member.name!r} is none of it"
            )
        yield member.name, stream


def _folder_parts(backup: Path) -> Iterator[tuple[str, IO[bytes]]]:
    for file in _files(backup):
        name = file.relative_to(backup).as_posix()
        if not file.is_file():
            raise CannotMaintain(f"{backup} is no backup: it has no file {name!r}")
        if not _is_part(name):
            raise CannotMaintain(f"{backup} is no backup: {name!r} is none of it")
        with file.open("rb") as stream:
            yield name, stream


def _files(backup: Path) -> list[Path]:
    stored = sorted((backup / BLOBS).glob("??/*"))
    return [backup / DATABASE, *stored, backup / LABEL]


def size_of(backup: Path) -> int:
    """Bytes of a backup; zero for what is none."""
    files = _files(backup) if backup.is_dir() else [backup]
    return sum(file.stat().st_size for file in files if file.is_file())


def _is_part(name: str) -> bool:
    # Names come from outside: nothing else is ever made into a path.
    return name in (LABEL, DATABASE) or _BLOB.fullmatch(name) is not None


def _copy(stream: IO[bytes], target: Path | None) -> str:
    digest = hashlib.sha256()
    if target is None:
        while chunk := stream.read(_CHUNK):
            digest.update(chunk)
        return digest.hexdigest()
    target.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with target.open("xb") as copy:
        while chunk := stream.read(_CHUNK):
            digest.update(chunk)
            copy.write(chunk)
    target.chmod(0o600)
    return digest.hexdigest()
