"""Looking a data folder over: what is wrong in it, and what to do about each."""

from __future__ import annotations

import os
import shutil
import stat
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Final

from sqlalchemy.orm import Session

from app.db.inspection import looking_at, problems_in
from app.db.migrate import current_revision, head_revision, is_known
from app.repositories.stored_files import StoredFileRepository, WantedFile
from app.resources import migrations_dir
from app.services.data_folder import (
    BLOBS,
    RESTORING,
    Steps,
    database_file,
    newer,
    no_database,
)
from app.settings import Settings
from app.storage import StoredFile, digest_of, leftovers, stored_files

SETTLED_S: Final = 3600.0
"""Files that changed within the last hour may belong to work that goes on."""
MOST_EXAMPLES: Final = 5
_OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO


class Severity(str, Enum):
    """How bad a finding is."""

    OK = "ok"
    NOTE = "note"
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True)
class Finding:
    """What one check found; `todo` says what to do, for all but the best."""

    check: str
    severity: Severity
    found: str
    todo: str = ""
    count: int = 0
    examples: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, object]:
        """As it is printed."""
        return {**vars(self), "severity": self.severity.value}


def examine(settings: Settings, *, verify: bool, steps: Steps) -> Iterator[Finding]:
    """Every check, one after the other; nothing is changed.

    With `verify` the content of each stored file is compared with its name.
    """
    yield from _folder(settings)
    file = database_file(settings)
    if file is not None and not file.is_file():
        yield _no_database(settings)
        return
    with looking_at(settings.sqlalchemy_url) as engine:
        problems = problems_in(engine)
        yield _database(problems)
        if problems:
            return
        schema = _schema(current_revision(engine))
        yield schema
        if schema.severity is Severity.ERROR:
            return
        with Session(engine) as session:
            yield from _files(settings, session, verify=verify, steps=steps)


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
            f"{free} bytes are free, {least} are wanted",
            "make room: delete datasets that nobody needs, then run `unghost gc`",
        )
    else:
        yield Finding("disk", Severity.OK, f"{free} bytes are free")


def _token(file: Path) -> Finding:
    if not file.exists():
        return Finding(
            "token",
            Severity.NOTE,
            "there is no token file",
            "the next start of `unghost serve` makes one",
        )
    mode = stat.S_IMODE(file.stat().st_mode)
    if os.name != "nt" and mode & _OTHERS:
        return Finding(
            "token",
            Severity.WARNING,
            f"others can read the token file (mode {mode:o})",
            "delete it and start again, which makes another token; keep it at mode 600",
        )
    return Finding("token", Severity.OK, "only its owner can read the token file")


def _no_database(settings: Settings) -> Finding:
    if (settings.data / RESTORING).exists():
        todo = "run `unghost restore` again, it was interrupted"
    elif any(stored_files(settings.data / BLOBS)):
        todo = "put it back, or restore a backup into another folder"
    else:
        todo = no_database(settings)
    return Finding("database", Severity.ERROR, "the database is missing", todo)


def _database(problems: list[str]) -> Finding:
    if not problems:
        return Finding("database", Severity.OK, "it is intact, and so are its keys")
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
            "install the version that wrote it, or restore a backup from before",
        )
    return Finding(
        "schema",
        Severity.WARNING,
        f"at {revision}, this version needs {head}",
        "make a backup; `unghost serve` brings it up to date when it starts",
    )


def _files(
    settings: Settings, session: Session, *, verify: bool, steps: Steps
) -> Iterator[Finding]:
    # Rows before files: a file is there before its row is.
    began = time.time()
    rows = StoredFileRepository(session)
    frames, exports = list(rows.of_frames()), list(rows.of_exports())
    open_exports = rows.open_exports()
    folder = settings.data / BLOBS
    there = {file.digest: file for file in stored_files(folder)}
    damaged = set(_damaged_files(folder, there, steps)) if verify else set()
    looked = "compared with their names" if verify else "there, and of their sizes"
    yield _of_rows("files", frames, there, damaged, looked)
    yield _of_rows("exports", exports, there, damaged, looked)
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
            for path, changed_at in leftovers(folder)
            if path.name not in names and changed_at < began - SETTLED_S
        ]
    )


def _damaged_files(
    folder: Path, there: Mapping[str, StoredFile], steps: Steps
) -> Iterator[str]:
    with steps("compare the files", "files") as advance:
        for done, digest in enumerate(sorted(there), 1):
            try:
                if digest_of(folder / digest[:2] / digest) != digest:
                    yield digest
            except FileNotFoundError:  # cleared away meanwhile
                continue
            except OSError:
                yield digest
            advance(done, len(there))


_ADVICE: Final = {
    "files": "copy them from the folder blobs of a backup, or send their frames again, "
    "one by one, with `PUT .../frames/KEY`, which writes what is gone or cut short "
    "(delete a file first whose content has changed)",
    "exports": "make these exports again",
}


def _of_rows(
    check: str,
    wanted: Sequence[WantedFile],
    there: Mapping[str, StoredFile],
    damaged: set[str],
    looked: str,
) -> Finding:
    bad = [file.sha256 for file in wanted if _is_bad(file, there, damaged)]
    if not bad:
        return Finding(check, Severity.OK, f"all are {looked}", count=len(wanted))
    missing = sum(digest not in there for digest in bad)
    severity = Severity.ERROR if check == "files" else Severity.WARNING
    found = f"of {len(wanted)}, {missing} are missing and {len(bad) - missing} damaged"
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
        return Finding("unused", Severity.OK, "every file belongs to something")
    size_bytes = sum(file.size_bytes for file in files)
    return Finding(
        "unused",
        Severity.NOTE,
        f"{len(files)} files of {size_bytes} bytes belong to nothing any more",
        "`unghost gc` removes them",
        len(files),
        tuple(file.digest for file in files[:MOST_EXAMPLES]),
    )


def _leftovers(paths: Sequence[Path]) -> Finding:
    if not paths:
        return Finding("leftovers", Severity.OK, "nothing half written lies about")
    return Finding(
        "leftovers",
        Severity.NOTE,
        f"{len(paths)} files were left half written",
        "`unghost gc` removes them",
        len(paths),
        tuple(path.name for path in paths[:MOST_EXAMPLES]),
    )
