"""Looking a data folder over: what is wrong in it, and what to do about each."""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from sqlalchemy import Engine
from sqlalchemy.orm import Session

from app.db.inspection import looking_at, problems_in
from app.db.migrate import current_revision, head_revision, is_known
from app.resources import migrations_dir
from app.services.data_folder import (
    RESTORING,
    CannotMaintain,
    Steps,
    database_file,
    newer,
    no_database,
)
from app.services.file_checks import file_findings
from app.services.file_store import stored_files_of
from app.services.findings import MOST_EXAMPLES, Finding, Severity
from app.services.server_checks import is_answering, server_findings
from app.settings import Settings

_OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO


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
        findings = list(_of_database(engine, on_server=file is None))
        yield from findings
        if any(found.severity is Severity.ERROR for found in findings):
            return
        with Session(engine) as session:
            yield from file_findings(settings, session, verify=verify, steps=steps)


def _of_database(engine: Engine, *, on_server: bool) -> Iterator[Finding]:
    """What is wrong with it; nothing more is asked after an error."""
    first = is_answering(engine) if on_server else _database(problems_in(engine))
    yield first
    if first.severity is Severity.ERROR:
        return
    schema = _schema(current_revision(engine))
    yield schema
    if on_server and schema.severity is not Severity.ERROR:
        yield from server_findings(engine)


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
            "the next start of `unghost serve` mends it and replaces the token",
        )
    return Finding("token", Severity.OK, "only its owner can read the token file")


def _no_database(settings: Settings) -> Finding:
    if (settings.data / RESTORING).exists():
        todo = "run `unghost restore` again, it was interrupted"
    elif _has_files(settings):
        todo = "put it back, or restore a backup into another folder"
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
