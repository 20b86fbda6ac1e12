"""Makes a backup of a data folder, also while the service runs, and unpacks one.

A backup is a folder or a tar file. It contains the database, the stored files under
`blobs/` (also those of a bucket) and, as its last file, a label. The database is copied
first, as a consistent snapshot. No file is deleted while a backup is made, so all files
to which the snapshot refers exist.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import sqlite3
import tarfile
from collections.abc import Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict, dataclass, field
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import IO, Final

from sqlalchemy.orm import Session

from app.addresses import FOLDER
from app.db.bulk import chunks
from app.db.inspection import (
    copy_database,
    foreign_triggers,
    problems_of,
    read_only_engine,
    referenced_files,
    revision_of,
)
from app.errors import DamagedFile
from app.maintenance.datafolder import (
    Advance,
    CannotMaintain,
    Steps,
    alone,
    database_file,
    no_database,
    stored_files_of,
)
from app.maintenance.queries import RowChecks
from app.package import VERSION
from app.settings import Settings
from app.storage import BLOBS
from app.storage.base import BlobStore, digest_of
from app.storage.durable import flush_everything, flush_file, flush_folder, make_folder

FORMAT: Final = 1
LABEL: Final = "backup.json"
DATABASE: Final = "unghost.db"
MAX_LABEL_BYTES: Final = 16 * 1024**2
"""Maximum size of a label: it can name some 200,000 files that were left out."""
_BLOB: Final = re.compile(rf"{BLOBS}/([0-9a-f]{{2}})/(\1[0-9a-f]{{62}})")
_CHUNK: Final = 1 << 20
_MB: Final = 10**6


@dataclass(frozen=True)
class BackupLabel:
    """The label of a backup: its version, and what it contains."""

    format: int
    version: str
    schema: str
    created_at: str
    files: int
    database_sha256: str
    left_out: tuple[str, ...] = ()

    def text(self) -> str:
        """The content of the label file."""
        return json.dumps(asdict(self), indent=2) + "\n"


def blob_name(digest: str) -> str:
    """The path of a blob in a backup."""
    return f"{BLOBS}/{digest[:2]}/{digest}"


def unpack(
    backup: Path, folder: Path, advance: Advance, *, keep: bool
) -> tuple[BackupLabel, int]:
    """Read and check a backup; unpack it into a folder, or only its database.

    Without `keep`, other files are only compared with their names. Returns its label
    and how many files it has. Raises CannotMaintain if it is not a backup, or is
    damaged or incomplete; the text says why.
    """
    digests: dict[str, str] = {}
    label, done, total = None, 0, size_of(backup)
    try:
        with closing(_parts(backup)) as parts:
            for name, stream in parts:
                if name == LABEL:
                    # The last file: it lists the files that were left out.
                    label = _read_label(stream.read(MAX_LABEL_BYTES + 1), backup)
                    continue
                target = folder / name if keep or name == DATABASE else None
                digests[name] = _copy(stream, target)
                if name != DATABASE and not name.endswith(digests[name]):
                    raise CannotMaintain(
                        f"{backup} is damaged: the content of {name} has changed"
                    )
                done += stream.tell()
                advance(done // _MB, total // _MB)
    except (tarfile.TarError, EOFError) as exc:
        raise CannotMaintain(
            f"{backup} is not a backup, or is truncated: {exc}"
        ) from exc
    if label is None:
        raise CannotMaintain(f"{backup} is not a backup: it has no {LABEL}")
    if digests.pop(DATABASE, None) != label.database_sha256:
        raise CannotMaintain(
            f"{backup} is damaged: the content of its database has changed"
        )
    _check_complete(backup, folder / DATABASE, set(digests), label)
    return label, len(digests)


def _check_complete(
    backup: Path, database: Path, names: set[str], label: BackupLabel
) -> None:
    try:
        triggers = foreign_triggers(database)
        problems = problems_of(database)
        referenced = referenced_files(database)
    except sqlite3.DatabaseError as exc:
        raise CannotMaintain(f"{backup}: its database cannot be read: {exc}") from exc
    missing = {blob_name(digest) for digest in referenced - {*label.left_out}} - names
    if triggers:
        # The service would execute it, and could give its author any right.
        raise CannotMaintain(
            f"{backup}: the trigger {triggers[0][:80]!r} is not Unghost's: drop it "
            "in the database, and make another backup"
        )
    if problems:
        raise CannotMaintain(f"{backup}: its database is damaged: {problems[0]}")
    if missing:
        raise CannotMaintain(
            f"{backup} is not complete: {len(missing)} files are missing, one is "
            f"{min(missing)}"
        )


def _read_label(content: bytes, backup: Path) -> BackupLabel:
    if len(content) > MAX_LABEL_BYTES:
        raise CannotMaintain(
            f"{backup}: its {LABEL} is longer than {MAX_LABEL_BYTES} bytes"
        )
    try:
        fields = json.loads(content)
        label = BackupLabel(**{**fields, "left_out": tuple(fields["left_out"])})
    except (ValueError, TypeError, KeyError) as exc:
        raise CannotMaintain(f"{backup}: its {LABEL} cannot be read") from exc
    if label.format != FORMAT:
        raise CannotMaintain(
            f"{backup} has format {label.format}, this version reads {FORMAT}"
        )
    return label


_MAX_HEADER: Final = 4096
"""Bytes of a further header, such as one of POSIX's format; ours have 100."""


class _Member(tarfile.TarInfo):
    """A member of an archive, or a header of the one that follows it."""

    @classmethod
    def frombuf(cls, buf: bytes | bytearray, encoding: str, errors: str) -> _Member:
        """A header; ReadError if Python would read it into memory, and slowly."""
        header = super().frombuf(buf, encoding, errors)
        if header.size < 0 or (header.size > _MAX_HEADER and not header.isreg()):
            raise tarfile.ReadError(
                f"expected a header of at most {_MAX_HEADER} bytes, found {header.size}"
            )
        return header


def _parts(backup: Path) -> Generator[tuple[str, IO[bytes]], None, None]:
    """The files of a backup by name, each open until the next one is asked for."""
    if not backup.is_dir():
        with tarfile.open(backup, "r:", tarinfo=_Member) as archive:
            for member in archive:
                stream = archive.extractfile(member) if member.isfile() else None
                if stream is None or not _is_part(member.name):
                    raise CannotMaintain(
                        f"{backup} is not a backup: backups contain no {member.name!r}"
                    )
                # Its holes take no bytes in the archive, and any number unpacked.
                if member.issparse():
                    raise CannotMaintain(
                        f"{backup} is not a backup: {member.name!r} is a sparse file"
                    )
                yield member.name, stream
        return
    for file in _files(backup):
        name = file.relative_to(backup).as_posix()
        if not file.is_file():
            raise CannotMaintain(f"{backup} is not a backup: {name!r} is not a file")
        if not _is_part(name):
            raise CannotMaintain(
                f"{backup} is not a backup: backups contain no {name!r}"
            )
        with file.open("rb") as part:
            yield name, part


def _files(backup: Path) -> list[Path]:
    stored = sorted((backup / BLOBS).glob("??/*"))
    return [backup / DATABASE, *stored, backup / LABEL]


def size_of(backup: Path) -> int:
    """Bytes of a backup; 0 if there is none at this path."""
    files = _files(backup) if backup.is_dir() else [backup]
    return sum(file.stat().st_size for file in files if file.is_file())


def _is_part(name: str) -> bool:
    # Names are untrusted: only these are used as paths.
    return name in (LABEL, DATABASE) or _BLOB.fullmatch(name) is not None


def _copy(stream: IO[bytes], target: Path | None) -> str:
    """The digest of a stream, which is copied if there is a target."""
    digest = hashlib.sha256()
    with ExitStack() as held:
        copy = None
        if target is not None:
            target.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            copy = held.enter_context(target.open("xb"))
            target.chmod(_PRIVATE)
        while chunk := stream.read(_CHUNK):
            digest.update(chunk)
            if copy is not None:
                copy.write(chunk)
    return digest.hexdigest()


TAR: Final = ".tar"
TOGETHER: Final = 8
"""Concurrent downloads of files from a bucket."""
_PRIVATE: Final = 0o600


@dataclass(frozen=True)
class Backup:
    """A backup that was made and verified; `left_out` are damaged files.

    `audit` is the mark of its audit log (`AuditMark`); earlier schemas have none.
    """

    path: Path
    files: int
    size_bytes: int
    schema: str
    audit: str | None
    left_out: tuple[str, ...]

    def as_dict(self) -> dict[str, object]:
        """The values for the command's output."""
        return {**vars(self), "path": str(self.path)}


@dataclass
class _Writing:
    """A backup that is being written."""

    folder: Path
    archive: tarfile.TarFile | None
    spare: Path
    files: int = 0
    left_out: list[str] = field(default_factory=list)

    def add(self, name: str, file: Path) -> None:
        if self.archive is None:
            target = self.folder / name
            if target == file:
                return
            target.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            shutil.copyfile(file, target)
            target.chmod(_PRIVATE)
            return
        entry = tarfile.TarInfo(name)
        entry.size, entry.mode = file.stat().st_size, _PRIVATE
        entry.mtime = int(file.stat().st_mtime)
        with file.open("rb") as stream:
            self.archive.addfile(entry, stream)


def make_backup(
    settings: Settings, target: Path, *, incomplete: bool, steps: Steps
) -> Backup:
    """Copy a data folder into a folder, or into a file if the name ends in ``.tar``.

    It is renamed to `target` when it is complete, verified and flushed to the disk.
    Raises CannotMaintain if `target` exists already, or if files are damaged and
    `incomplete` is False.
    """
    source = _source(settings)
    target = target.absolute()
    if target.exists():
        raise CannotMaintain(
            f"{target} exists already; a backup is written to a new place"
        )
    if settings.data.resolve() in target.resolve().parents:
        raise CannotMaintain("a backup inside the data folder would be lost with it")
    with alone(settings), _draft_of(target) as draft:
        with _writing(target, draft) as writing:
            database = writing.folder / DATABASE
            with steps("copy the database", "pages") as advance:
                copy_database(source, database, advance)
            database.chmod(_PRIVATE)
            with read_only_engine(database) as engine, Session(engine) as session:
                rows = RowChecks(session)
                audit = str(rows.audit_mark()) if rows.has_audit_log() else None
            writing.add(DATABASE, database)
            _add_files(settings, writing, steps, incomplete=incomplete)
            label = BackupLabel(
                format=FORMAT,
                version=VERSION,
                schema=revision_of(database) or "",
                created_at=datetime.now(timezone.utc).isoformat(timespec="seconds"),
                files=writing.files,
                database_sha256=digest_of(database),
                left_out=tuple(writing.left_out),
            )
            text = writing.folder / LABEL
            text.write_text(label.text(), "utf-8")
            text.chmod(_PRIVATE)
            writing.add(LABEL, text)
        written, again = draft / target.name, draft / ".again"
        again.mkdir()
        with steps("verify the backup", "MB") as advance:
            unpack(written, again, advance, keep=False)
        size_bytes = size_of(written)
        if written.is_file():
            flush_file(written)
        else:
            for name in (DATABASE, LABEL):
                flush_file(written / name)
            flush_everything(written)
        written.rename(target)
        flush_folder(target.parent)
    return Backup(target, label.files, size_bytes, label.schema, audit, label.left_out)


def _source(settings: Settings) -> Path:
    file = database_file(settings)
    if file is None:
        folder = settings.data / BLOBS
        files = (
            f"copy the folder {str(folder)!r}"
            if settings.storage == FOLDER
            else f"copy {settings.storage}, or let its bucket keep versions"
        )
        raise CannotMaintain(
            "the database is on a PostgreSQL server: save it with `pg_dump "
            f"--format=custom`, and after that {files}; run no `unghost gc` in "
            "between. To restore both, use `pg_restore` and copy the files back"
        )
    if not file.is_file():
        raise CannotMaintain(no_database(settings))
    return file


@contextmanager
def _draft_of(target: Path) -> Iterator[Path]:
    """A temporary folder next to the target, for the incomplete backup."""
    draft = target.with_name(f".{target.name}.partial")
    # Left by a killed backup: of a folder that can be locked, no other one is running.
    shutil.rmtree(draft, ignore_errors=True)
    make_folder(target.parent)
    draft.mkdir(mode=0o700)
    try:
        yield draft
    finally:
        shutil.rmtree(draft, ignore_errors=True)


@contextmanager
def _writing(target: Path, draft: Path) -> Iterator[_Writing]:
    written = draft / target.name
    if target.suffix != TAR:
        written.mkdir(mode=0o700)
        yield _Writing(written, None, draft / ".fetched")
        return
    with tarfile.open(written, "x:", format=tarfile.PAX_FORMAT) as archive:
        written.chmod(_PRIVATE)
        yield _Writing(draft, archive, draft / ".fetched")


def _add_files(
    settings: Settings, writing: _Writing, steps: Steps, *, incomplete: bool
) -> None:
    digests = sorted(referenced_files(writing.folder / DATABASE))
    # Files of a disk are read one by one, those of a bucket concurrently.
    together, done = 1 if settings.storage == FOLDER else TOGETHER, 0
    with (
        stored_files_of(settings) as store,
        steps("copy the files", "files") as advance,
        ThreadPoolExecutor(together) as pool,
    ):
        for some in chunks(digests, together):
            # Copies of files of a bucket are deleted before the next ones are fetched.
            writing.spare.mkdir(mode=0o700)
            fetched = pool.map(partial(_intact_file, store, writing.spare), some)
            for digest, file in zip(some, fetched, strict=True):
                if not isinstance(file, DamagedFile):
                    writing.add(blob_name(digest), file)
                    writing.files += 1
                elif incomplete:
                    writing.left_out.append(digest)
                else:
                    raise CannotMaintain(
                        f"{file}; --incomplete makes a backup without them"
                    ) from file
                done += 1
                advance(done, len(digests))
            shutil.rmtree(writing.spare)


def _intact_file(store: BlobStore, spare: Path, digest: str) -> Path | DamagedFile:
    """The file of a blob, or a copy in the spare folder, if its content is right."""
    try:
        blob = store.open(digest, size_bytes=None)
        file = blob.path
        if file is None:
            file = spare / digest
            with file.open("wb") as copy:
                copy.writelines(blob.pieces())
        if digest_of(file) != digest:
            raise DamagedFile(digest, "has changed since it was stored")
    except DamagedFile as damaged:
        return damaged
    return file
