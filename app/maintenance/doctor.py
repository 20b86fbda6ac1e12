"""Checks a data folder: reports what is wrong, and what to do about it."""

from __future__ import annotations

import os
import shutil
import stat
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Final

from sqlalchemy import Engine
from sqlalchemy.orm import Session

from app.addresses import FOLDER
from app.db.inspection import (
    broken_keys,
    connection_fault,
    missing_triggers,
    not_durable,
    problems_in,
    read_only_engine,
    version_of,
)
from app.db.migrate import current_revision, head_revision, is_known
from app.errors import DamagedFile
from app.maintenance.datafolder import (
    RESTORING,
    CannotMaintain,
    Steps,
    database_file,
    newer,
    no_database,
    stored_files_of,
)
from app.maintenance.queries import (
    AuditMark,
    RowChecks,
    StoredFileRepository,
    WantedFile,
)
from app.package import migrations_dir
from app.settings import Settings
from app.storage.base import BlobStore, StoredFile, export_of

_OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO

SETTLED_S: Final = 3600.0
"""Files that changed within the last hour may belong to work in progress."""
TOGETHER: Final = 8
"""Concurrent reads of files from a bucket; files of a disk are read one by one."""

_ADVICE: Final = {
    "files": "copy them from the folder blobs of a backup, or send their frames again, "
    "one by one, with `PUT .../frames/KEY`, which writes missing and truncated files "
    "(first delete files whose content has changed)",
    "exports": "make these exports again",
}

MOST_EXAMPLES: Final = 5


class Severity(str, Enum):
    """The severity of a finding."""

    OK = "ok"
    NOTE = "note"
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True)
class Finding:
    """The result of one check; `todo` says what to do, unless it is OK."""

    check: str
    severity: Severity
    found: str
    todo: str = ""
    count: int = 0
    examples: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, object]:
        """The values for the command's output."""
        return {**vars(self), "severity": self.severity.value}


def examine(
    settings: Settings, *, verify: bool, steps: Steps, audit: AuditMark | None = None
) -> Iterator[Finding]:
    """Run all checks, one after the other; nothing is changed.

    With `verify`, the content of each stored file is compared with its hash. `audit` is
    what a backup or an earlier check has printed about the audit log.
    """
    yield from _folder(settings)
    file = database_file(settings)
    if file is not None and not file.is_file():
        yield _no_database(settings)
        return
    with read_only_engine(settings.sqlalchemy_url) as engine:
        findings = list(_of_database(engine, on_server=file is None))
        yield from findings
        if any(found.severity is Severity.ERROR for found in findings):
            return
        with Session(engine) as session:
            # Earlier schemas lack some of the tables and columns.
            if current_revision(engine) == head_revision(migrations_dir()):
                yield from row_findings(engine, session, audit)
            elif audit is not None:
                yield _NOT_COMPARED
            yield from file_findings(settings, session, verify=verify, steps=steps)


def _of_database(engine: Engine, *, on_server: bool) -> Iterator[Finding]:
    """Findings about the database; stops after an error."""
    first = is_answering(engine) if on_server else _database(problems_in(engine))
    yield first
    if first.severity is Severity.ERROR:
        return
    schema = _schema(current_revision(engine))
    yield schema
    if on_server and schema.severity is not Severity.ERROR:
        yield from server_findings(engine)


_NOT_COMPARED: Final = Finding(
    "audit",
    Severity.WARNING,
    "it was not compared: the schema is older",
    "let `unghost serve` bring the schema up to date, then run this again",
)


def row_findings(
    engine: Engine, session: Session, audit: AuditMark | None
) -> Iterator[Finding]:
    """Findings about the audit log, answers and counts of boxes."""
    checks = RowChecks(session)
    yield _audit(missing_triggers(engine), checks, audit)
    yield _answers(checks.altered_answers())
    yield _counts(checks.altered_counts())


def _audit(missing: list[str], checks: RowChecks, noted: AuditMark | None) -> Finding:
    if noted is not None:
        first = checks.audit_mark(noted.entries)
        if first != noted:
            found = (
                f"only {first.entries} of {noted.entries} entries are there"
                if first.entries < noted.entries
                else f"its first {noted.entries} entries are not those that were noted"
            )
            return Finding(
                "audit",
                Severity.ERROR,
                f"{found}: entries were removed or changed",
                "restore the backup with which they were noted into another folder, "
                "and compare the tables audit_log",
                1,
            )
    if missing:
        return Finding(
            "audit",
            Severity.ERROR,
            f"{len(missing)} of its triggers are missing: entries can be changed",
            "compare it with what the last backup has printed (`unghost doctor "
            "--audit`), then make the triggers again, with these statements",
            len(missing),
            tuple(missing),
        )
    mark = checks.audit_mark()
    found = f"its triggers are there; later, compare with `--audit {mark}`"
    return Finding("audit", Severity.OK, found, count=mark.entries)


def _answers(box_ids: Sequence[int]) -> Finding:
    if not box_ids:
        return Finding("answers", Severity.OK, "no answer on a box is missing")
    return Finding(
        "answers",
        Severity.ERROR,
        f"answers on {len(box_ids)} boxes were removed or changed in the database",
        "restore the last backup in which they are `ok` into another folder, and "
        "compare the history of these boxes",
        len(box_ids),
        tuple(f"box {box_id}" for box_id in box_ids[:MOST_EXAMPLES]),
    )


def _counts(wrong: Mapping[str, int]) -> Finding:
    if not wrong:
        return Finding("counts", Severity.OK, "they are those of the stored boxes")
    return Finding(
        "counts",
        Severity.WARNING,
        f"counts of boxes in {len(wrong)} datasets were changed in the database",
        "count again: `unghost config show DATASET > filter.yaml`, then `unghost run "
        "DATASET --config filter.yaml --activate`",
        sum(wrong.values()),
        tuple(f"dataset {name!r}: {number}" for name, number in wrong.items())[
            :MOST_EXAMPLES
        ],
    )


def _folder(settings: Settings) -> Iterator[Finding]:
    if not settings.data.is_dir():
        return
    yield _token(settings.token_file)
    free = shutil.disk_usage(settings.data).free
    least = int(settings.min_free_bytes)
    if free < least:
        yield Finding(
            "disk",
            Severity.WARNING,
            f"{free} bytes are free, {least} are needed",
            "delete datasets that are no longer needed, then run `unghost gc`",
        )
    else:
        yield Finding("disk", Severity.OK, f"{free} bytes are free")


def _token(file: Path) -> Finding:
    if not file.exists():
        return Finding(
            "token",
            Severity.NOTE,
            "there is no token file",
            "the next start of `unghost serve` creates one",
        )
    mode = stat.S_IMODE(file.stat().st_mode)
    if os.name != "nt" and mode & _OTHERS:
        return Finding(
            "token",
            Severity.WARNING,
            f"others can read the token file (mode {mode:o})",
            "the next start of `unghost serve` restricts its permissions and replaces "
            "the token",
        )
    return Finding("token", Severity.OK, "only its owner can read the token file")


def _no_database(settings: Settings) -> Finding:
    if (settings.data / RESTORING).exists():
        todo = "run `unghost restore` again: it was interrupted"
    elif _has_files(settings):
        todo = "put its file back, or restore a backup into another folder"
    else:
        todo = no_database(settings)
    return Finding("database", Severity.ERROR, "the database is missing", todo)


def _has_files(settings: Settings) -> bool:
    try:
        with stored_files_of(settings) as store:
            return any(store.files())
    except CannotMaintain:
        return False


def _database(problems: list[str]) -> Finding:
    if not problems:
        return Finding("database", Severity.OK, "its pages and foreign keys are intact")
    return Finding(
        "database",
        Severity.ERROR,
        f"it is damaged: {problems[0]}",
        "stop the service, keep a copy of the folder, and restore the last backup "
        "into another one",
        len(problems),
        tuple(problems[:MOST_EXAMPLES]),
    )


def _schema(revision: str | None) -> Finding:
    head = head_revision(migrations_dir())
    if revision == head:
        return Finding("schema", Severity.OK, f"at {revision}, as this version needs")
    if revision is None or not is_known(migrations_dir(), revision):
        found = newer(revision) if revision else "the database has no schema"
        return Finding(
            "schema",
            Severity.ERROR,
            found,
            "install the version that wrote it, or restore an older backup",
        )
    return Finding(
        "schema",
        Severity.WARNING,
        f"at {revision}, this version needs {head}",
        "make a backup; `unghost serve` brings it up to date when it starts",
    )


def file_findings(
    settings: Settings, session: Session, *, verify: bool, steps: Steps
) -> Iterator[Finding]:
    """Findings about the files, in a folder or a bucket; nothing is changed."""
    try:
        with stored_files_of(settings) as store:
            if settings.storage != FOLDER:
                yield _bucket(store)
            asked = 1 if settings.storage == FOLDER else TOGETHER
            verifying = _Verifying(store, steps, asked) if verify else None
            yield from _findings(store, session, verifying)
    except CannotMaintain as exc:
        yield Finding(
            "store",
            Severity.ERROR,
            str(exc),
            "fix this first: until then, nothing can be stored, shown or measured",
        )


def _bucket(store: BlobStore) -> Finding:
    any(store.files())
    return Finding("store", Severity.OK, "the bucket answers")


@dataclass(frozen=True)
class _Verifying:
    """Reads every file, `asked` at a time, to verify its content."""

    store: BlobStore
    steps: Steps
    asked: int

    def damaged(self, there: Mapping[str, StoredFile]) -> set[str]:
        """The names of files whose content does not match their hash."""
        names = sorted(there)
        with (
            self.steps("compare the files", "files") as advance,
            ThreadPoolExecutor(self.asked) as pool,
        ):
            found = set()
            whole = pool.map(self._is_whole, [there[name] for name in names])
            for done, (name, good) in enumerate(zip(names, whole, strict=True), 1):
                if not good:
                    found.add(name)
                advance(done, len(names))
        return found

    def _is_whole(self, file: StoredFile) -> bool:
        try:
            self.store.open_verified(file.digest, size_bytes=file.size_bytes)
        except (DamagedFile, OSError):
            return False
        return True


def _findings(
    store: BlobStore, session: Session, verifying: _Verifying | None
) -> Iterator[Finding]:
    # Rows are read before files: a file is stored before its row.
    began = time.time()
    rows = StoredFileRepository(session)
    frames, exports = list(rows.of_frames()), list(rows.of_exports())
    open_exports = rows.open_exports()
    there = {file.digest: file for file in store.files()}
    damaged = verifying.damaged(there) if verifying else set()
    state = "match their hashes" if verifying else "exist and have the right size"
    yield _of_rows("files", frames, there, damaged, state)
    yield _of_rows("exports", exports, there, damaged, state)
    used = {file.sha256 for file in (*frames, *exports)}
    yield _unused(
        [
            file
            for digest, file in there.items()
            if digest not in used and file.modified_at < began - SETTLED_S
        ]
    )
    names = {f"export-{number}" for number in open_exports}
    yield _leftovers(
        [
            path
            for path, changed_at in store.leftovers()
            if export_of(path) not in names and changed_at < began - SETTLED_S
        ]
    )


def _of_rows(
    check: str,
    wanted: Sequence[WantedFile],
    there: Mapping[str, StoredFile],
    damaged: set[str],
    state: str,
) -> Finding:
    bad = [file.sha256 for file in wanted if _is_bad(file, there, damaged)]
    if not bad:
        return Finding(check, Severity.OK, f"all {state}", count=len(wanted))
    missing = sum(digest not in there for digest in bad)
    severity = Severity.ERROR if check == "files" else Severity.WARNING
    found = f"{missing} of {len(wanted)} are missing, {len(bad) - missing} are damaged"
    return Finding(
        check, severity, found, _ADVICE[check], len(bad), tuple(bad[:MOST_EXAMPLES])
    )


def _is_bad(
    file: WantedFile, there: Mapping[str, StoredFile], damaged: set[str]
) -> bool:
    found = there.get(file.sha256)
    if found is None or file.sha256 in damaged:
        return True
    return file.size_bytes is not None and found.size_bytes != file.size_bytes


def _unused(files: Sequence[StoredFile]) -> Finding:
    if not files:
        return Finding("unused", Severity.OK, "every file is in use")
    size_bytes = sum(file.size_bytes for file in files)
    return Finding(
        "unused",
        Severity.NOTE,
        f"{len(files)} files of {size_bytes} bytes are no longer used",
        "`unghost gc` removes them",
        len(files),
        tuple(file.digest for file in files[:MOST_EXAMPLES]),
    )


def _leftovers(paths: Sequence[Path]) -> Finding:
    if not paths:
        return Finding("leftovers", Severity.OK, "there are no incomplete files")
    return Finding(
        "leftovers",
        Severity.NOTE,
        f"{len(paths)} files are incomplete, left by interrupted writes",
        "`unghost gc` removes them",
        len(paths),
        tuple(path.name for path in paths[:MOST_EXAMPLES]),
    )


def is_answering(engine: Engine) -> Finding:
    """Whether the database server responds."""
    reason = connection_fault(engine)
    if not reason:
        found = f"PostgreSQL {version_of(engine)} answers"
        return Finding("database", Severity.OK, found)
    return Finding(
        "database",
        Severity.ERROR,
        f"it does not respond: {reason}",
        "start PostgreSQL, create the database, or correct UNGHOST_DATABASE_URL; "
        "until then, the service answers no requests",
    )


def server_findings(engine: Engine) -> Iterator[Finding]:
    """Findings about a database on a server, which responds and has a known schema."""
    yield _keys(broken_keys(engine))
    yield _durability(not_durable(engine))


def _keys(problems: list[str]) -> Finding:
    if not problems:
        return Finding("keys", Severity.OK, "no row refers to a missing row")
    return Finding(
        "keys",
        Severity.ERROR,
        f"rows refer to missing rows: {problems[0]}",
        "restore the last dump into a new database, with `pg_restore "
        "--exit-on-error`, and its copy of the files",
        len(problems),
        tuple(problems[:MOST_EXAMPLES]),
    )


def _durability(off: list[str]) -> Finding:
    if not off:
        return Finding("durability", Severity.OK, "acknowledged writes are on the disk")
    return Finding(
        "durability",
        Severity.WARNING,
        f"a power cut may lose acknowledged writes: {', '.join(off)}",
        "turn it on in postgresql.conf, or with ALTER SYSTEM, and reload the server",
        len(off),
        tuple(off),
    )
