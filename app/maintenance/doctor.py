"""Checks a data folder: reports what is wrong, and what to do about it."""

from __future__ import annotations

import os
import shutil
import stat
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final

from sqlalchemy import Engine
from sqlalchemy.orm import Session

from app.addresses import FOLDER
from app.db import inspection
from app.db.migrate import current_revision, head_revision, is_known
from app.errors import DamagedFile
from app.maintenance import datafolder
from app.maintenance.queries import (
    AuditMark,
    RowChecks,
    StoredFileRepository,
    WantedFile,
)
from app.package import migrations_dir
from app.settings import Settings
from app.storage.base import BlobStore, StoredFile, left_over

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


def _unless_none(bad: Finding, names: Sequence[str], good: str) -> Finding:
    """The finding with these as examples; `good` if there are none."""
    if not names:
        return Finding(bad.check, Severity.OK, good)
    return replace(bad, count=len(names), examples=tuple(names[:MOST_EXAMPLES]))


def examine(
    settings: Settings,
    *,
    verify: bool,
    steps: datafolder.Steps,
    audit: AuditMark | None = None,
) -> Iterator[Finding]:
    """Run all checks, one after the other; nothing is changed.

    With `verify`, the content of each stored file is compared with its hash. `audit` is
    what a backup or an earlier check has printed about the audit log.
    """
    if settings.data.is_dir():
        yield from _folder(settings)
    file = datafolder.database_file(settings)
    if file is not None and not file.is_file():
        yield _no_database(settings)
        return
    with inspection.read_only_engine(settings.sqlalchemy_url) as engine:
        findings = list(_of_database(engine, on_server=file is None))
        yield from findings
        if any(finding.severity is Severity.ERROR for finding in findings):
            return
        with Session(engine) as session:
            # Earlier schemas lack some of the tables and columns.
            if current_revision(engine) == head_revision(migrations_dir()):
                yield from row_findings(engine, session, audit)
            elif audit is not None:
                yield Finding(
                    "audit",
                    Severity.WARNING,
                    "it was not compared: the schema is older",
                    "let `unghost serve` bring the schema up to date, then run this "
                    "again",
                )
            yield from file_findings(settings, session, verify=verify, steps=steps)


def _of_database(engine: Engine, *, on_server: bool) -> Iterator[Finding]:
    """Findings about the database; stops after an error."""
    if on_server:
        first = is_answering(engine)
    else:
        problems = inspection.problems_in(engine)
        damaged = Finding(
            "database",
            Severity.ERROR,
            f"it is damaged: {''.join(problems[:1])}",
            "stop the service, keep a copy of the folder, and restore the last backup "
            "into another one",
        )
        first = _unless_none(damaged, problems, "its pages and foreign keys are intact")
    yield first
    if first.severity is Severity.ERROR:
        return
    schema = _schema(current_revision(engine))
    yield schema
    if on_server and schema.severity is not Severity.ERROR:
        yield from server_findings(engine)


def row_findings(
    engine: Engine, session: Session, audit: AuditMark | None
) -> Iterator[Finding]:
    """Findings about the audit log, answers and counts of boxes."""
    checks = RowChecks(session)
    yield _audit(inspection.missing_triggers(engine), checks, audit)
    box_ids = checks.altered_answers()
    altered = Finding(
        "answers",
        Severity.ERROR,
        f"answers on {len(box_ids)} boxes were removed or changed in the database",
        "restore the last backup in which they are `ok` into another folder, and "
        "compare the history of these boxes",
    )
    boxes = [f"box {box_id}" for box_id in box_ids]
    yield _unless_none(altered, boxes, "no answer on a box is missing")
    wrong = checks.altered_counts()
    counted = Finding(
        "counts",
        Severity.WARNING,
        f"counts of boxes in {len(wrong)} datasets were changed in the database",
        "count again: `unghost config show DATASET > filter.yaml`, then `unghost run "
        "DATASET --config filter.yaml --activate`",
    )
    named = [f"dataset {name!r}: {number}" for name, number in wrong.items()]
    finding = _unless_none(counted, named, "they are those of the stored boxes")
    yield replace(finding, count=sum(wrong.values()))


def _audit(missing: list[str], checks: RowChecks, noted: AuditMark | None) -> Finding:
    if noted is not None:
        first = checks.audit_mark(noted.entries)
        if first != noted:
            summary = (
                f"only {first.entries} of {noted.entries} entries are there"
                if first.entries < noted.entries
                else f"its first {noted.entries} entries are not those that were noted"
            )
            return Finding(
                "audit",
                Severity.ERROR,
                f"{summary}: entries were removed or changed",
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
    summary = f"its triggers are there; later, compare with `--audit {mark}`"
    return Finding("audit", Severity.OK, summary, count=mark.entries)


def _folder(settings: Settings) -> Iterator[Finding]:
    file = settings.token_file
    mode = stat.S_IMODE(file.stat().st_mode) if file.exists() else None
    if mode is None:
        yield Finding(
            "token",
            Severity.NOTE,
            "there is no token file",
            "the next start of `unghost serve` creates one",
        )
    elif os.name != "nt" and mode & _OTHERS:
        yield Finding(
            "token",
            Severity.WARNING,
            f"others can read the token file (mode {mode:o})",
            "the next start of `unghost serve` restricts its permissions and replaces "
            "the token",
        )
    else:
        yield Finding("token", Severity.OK, "only its owner can read the token file")
    free, least = shutil.disk_usage(settings.data).free, int(settings.min_free_bytes)
    if free < least:
        yield Finding(
            "disk",
            Severity.WARNING,
            f"{free} bytes are free, {least} are needed",
            "delete datasets that are no longer needed, then run `unghost gc`",
        )
    else:
        yield Finding("disk", Severity.OK, f"{free} bytes are free")


def _no_database(settings: Settings) -> Finding:
    has_files = False
    with (
        suppress(datafolder.CannotMaintain),
        datafolder.stored_files_of(settings) as store,
    ):
        has_files = any(store.files())
    if (settings.data / datafolder.RESTORING).exists():
        todo = "run `unghost restore` again: it was interrupted"
    elif has_files:
        todo = "put its file back, or restore a backup into another folder"
    else:
        todo = datafolder.no_database(settings)
    return Finding("database", Severity.ERROR, "the database is missing", todo)


def _schema(revision: str | None) -> Finding:
    head = head_revision(migrations_dir())
    if revision == head:
        return Finding("schema", Severity.OK, f"at {revision}, as this version needs")
    if revision is None or not is_known(migrations_dir(), revision):
        summary = (
            datafolder.newer(revision) if revision else "the database has no schema"
        )
        return Finding(
            "schema",
            Severity.ERROR,
            summary,
            "install the version that wrote it, or restore an older backup",
        )
    return Finding(
        "schema",
        Severity.WARNING,
        f"at {revision}, this version needs {head}",
        "make a backup; `unghost serve` brings it up to date when it starts",
    )


def file_findings(
    settings: Settings, session: Session, *, verify: bool, steps: datafolder.Steps
) -> Iterator[Finding]:
    """Findings about the files, in a folder or a bucket; nothing is changed."""
    is_folder = settings.storage == FOLDER
    try:
        with datafolder.stored_files_of(settings) as store:
            if not is_folder:
                any(store.files())
                yield Finding("store", Severity.OK, "the bucket answers")
            # Rows are read before files: a file is stored before its row.
            settled = time.time() - SETTLED_S
            rows = StoredFileRepository(session)
            frames, exports = list(rows.of_frames()), list(rows.of_exports())
            at_work = rows.open_exports()
            there = {file.digest: file for file in store.files()}
            at_once = 1 if is_folder else TOGETHER
            damaged = _damaged(store, there, steps, at_once) if verify else None
            yield _of_rows("files", frames, there, damaged)
            yield _of_rows("exports", exports, there, damaged)
            used = {file.sha256 for file in (*frames, *exports)}
            unused = [
                file
                for digest, file in there.items()
                if digest not in used and file.modified_at < settled
            ]
            size_bytes = sum(file.size_bytes for file in unused)
            garbage = Finding(
                "unused",
                Severity.NOTE,
                f"{len(unused)} files of {size_bytes} bytes are no longer used",
                "`unghost gc` removes them",
            )
            digests = [file.digest for file in unused]
            yield _unless_none(garbage, digests, "every file is in use")
            left = [path.name for path in left_over(store, at_work, settled)]
            incomplete = Finding(
                "leftovers",
                Severity.NOTE,
                f"{len(left)} files are incomplete, left by interrupted writes",
                "`unghost gc` removes them",
            )
            yield _unless_none(incomplete, left, "there are no incomplete files")
    except datafolder.CannotMaintain as exc:
        yield Finding(
            "store",
            Severity.ERROR,
            str(exc),
            "fix this first: until then, nothing can be stored, shown or measured",
        )


def _damaged(
    store: BlobStore,
    there: Mapping[str, StoredFile],
    steps: datafolder.Steps,
    at_once: int,
) -> set[str]:
    """The names of files whose content does not match their hash.

    Every file is read, `asked` at a time.
    """

    def is_damaged(name: str) -> bool:
        try:
            store.open_verified(name, size_bytes=there[name].size_bytes)
        except (DamagedFile, OSError):
            return True
        return False

    names, damaged = sorted(there), set()
    with (
        steps("compare the files", "files") as advance,
        ThreadPoolExecutor(at_once) as pool,
    ):
        verified = zip(names, pool.map(is_damaged, names), strict=True)
        for done, (name, is_bad) in enumerate(verified, 1):
            if is_bad:
                damaged.add(name)
            advance(done, len(names))
    return damaged


def _of_rows(
    check: str,
    files: Sequence[WantedFile],
    there: Mapping[str, StoredFile],
    damaged: set[str] | None,
) -> Finding:
    """A finding about the files of rows; `damaged` is None if none was read."""
    missing = [file.sha256 for file in files if file.sha256 not in there]
    bad = [
        file.sha256
        for file in files
        if file.sha256 not in there
        or file.sha256 in (damaged or ())
        or file.size_bytes not in (None, there[file.sha256].size_bytes)
    ]
    if not bad:
        state = "exist and have the right size"
        state = state if damaged is None else "match their hashes"
        return Finding(check, Severity.OK, f"all {state}", count=len(files))
    severity = Severity.ERROR if check == "files" else Severity.WARNING
    wrong = len(bad) - len(missing)
    summary = f"{len(missing)} of {len(files)} are missing, {wrong} are damaged"
    finding = Finding(check, severity, summary, _ADVICE[check])
    return _unless_none(finding, bad, "")


def is_answering(engine: Engine) -> Finding:
    """Whether the database server responds."""
    reason = inspection.connection_fault(engine)
    if not reason:
        summary = f"PostgreSQL {inspection.version_of(engine)} answers"
        return Finding("database", Severity.OK, summary)
    return Finding(
        "database",
        Severity.ERROR,
        f"it does not respond: {reason}",
        "start PostgreSQL, create the database, or correct UNGHOST_DATABASE_URL; "
        "until then, the service answers no requests",
    )


def server_findings(engine: Engine) -> Iterator[Finding]:
    """Findings about a database on a server, which responds and has a known schema."""
    keys, off = inspection.broken_keys(engine), inspection.not_durable(engine)
    broken = Finding(
        "keys",
        Severity.ERROR,
        f"rows refer to missing rows: {''.join(keys[:1])}",
        "restore the last dump into a new database, with `pg_restore "
        "--exit-on-error`, and its copy of the files",
    )
    yield _unless_none(broken, keys, "no row refers to a missing row")
    loses = Finding(
        "durability",
        Severity.WARNING,
        f"a power cut may lose acknowledged writes: {', '.join(off)}",
        "turn it on in postgresql.conf, or with ALTER SYSTEM, and reload the server",
    )
    yield _unless_none(loses, off, "acknowledged writes are on the disk")
