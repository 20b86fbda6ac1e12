"""Whether the stored files are those that rows refer to: a part of `unghost doctor`."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sqlalchemy.orm import Session

from app.errors import DamagedFile
from app.repositories.stored_files import StoredFileRepository, WantedFile
from app.services.data_folder import CannotMaintain, Steps
from app.services.file_store import stored_files_of
from app.services.findings import MOST_EXAMPLES, Finding, Severity
from app.settings import Settings
from app.storage import BlobStore, StoredFile, export_of
from app.storage_url import FOLDER

SETTLED_S: Final = 3600.0
"""Files that changed within the last hour may belong to work that goes on."""
TOGETHER: Final = 8
"""Files of a bucket that are read at the same time; a disk is read in order."""


def file_findings(
    settings: Settings, session: Session, *, verify: bool, steps: Steps
) -> Iterator[Finding]:
    """What is wrong with the files, wherever they are stored; nothing is changed."""
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
            "mend that first: nothing can be stored, shown or measured until then",
        )


def _bucket(store: BlobStore) -> Finding:
    any(store.files())
    return Finding("store", Severity.OK, "the bucket answers")


@dataclass(frozen=True)
class _Verifying:
    """Reading every file, `asked` at a time."""

    store: BlobStore
    steps: Steps
    asked: int

    def damaged(self, there: Mapping[str, StoredFile]) -> set[str]:
        """Those whose content is not what was stored."""
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
            self.store.intact(file.digest, size_bytes=file.size_bytes)
        except (DamagedFile, OSError):
            return False
        return True


def _findings(
    store: BlobStore, session: Session, verifying: _Verifying | None
) -> Iterator[Finding]:
    # Rows before files: a file is there before its row is.
    began = time.time()
    rows = StoredFileRepository(session)
    frames, exports = list(rows.of_frames()), list(rows.of_exports())
    open_exports = rows.open_exports()
    there = {file.digest: file for file in store.files()}
    damaged = verifying.damaged(there) if verifying else set()
    looked = "compared with their names" if verifying else "there, and of their sizes"
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
            for path, changed_at in store.leftovers()
            if export_of(path) not in names and changed_at < began - SETTLED_S
        ]
    )


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
