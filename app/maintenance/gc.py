"""Garbage collection of files that nothing refers to, while the service runs.

Files are removed in a transaction that writes, and so is the row of a frame, whose
transaction checks that its files exist (`BlobStore.require`). One of the two comes
first: either the frame's row is found here and its files stay, or its transaction finds
that a file is missing. Files younger than the grace period stay as well; otherwise
frames that are being stored would often have to be sent twice.
"""

from __future__ import annotations

import shutil
import time
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Final

from app.db.bulk import chunks
from app.db.engine import Database, keep_turn
from app.maintenance.datafolder import Steps, alone, opened, stored_files_of
from app.maintenance.queries import StoredFileRepository
from app.settings import Settings
from app.storage.base import BlobStore, left_over
from app.storage.room import Reserve

HOUR_S: Final = 3600.0
TOGETHER: Final = 200
"""Files that are removed in one transaction, which delays writers by milliseconds."""
SHORTEST_S: Final = HOUR_S
"""Minimum age at which drafts and incomplete exports count as left over."""


@dataclass
class Garbage:
    """The garbage that was found and, unless it was a dry run, removed."""

    removed: bool
    files: int = 0
    size_bytes: int = 0
    rows: int = 0
    leftovers: int = 0
    too_young: int = 0

    def as_dict(self) -> dict[str, int | bool]:
        """The values for the command's output."""
        return dict(vars(self))


def collect(
    settings: Settings, *, grace_hours: float, dry_run: bool, steps: Steps
) -> Garbage:
    """Remove files, rows and drafts that nothing refers to.

    Raises CannotMaintain if the folder cannot be used, or is locked by another such
    command.
    """
    with ExitStack() as held:
        held.enter_context(alone(settings))
        if not dry_run:
            Reserve(settings.data).give_up()
        database = held.enter_context(opened(settings))
        store = held.enter_context(stored_files_of(settings))
        until = time.time() - grace_hours * HOUR_S
        garbage = Garbage(removed=not dry_run)
        young = _files(database, store, garbage, until, steps)
        # Rows of files that no frame has and that are not young: after the files, as a
        # young file may belong to a frame that is being stored.
        with database.read() as session:
            unused = StoredFileRepository(session).unused_rows()
            at_work = StoredFileRepository(session).open_exports()
        unused = [digest for digest in unused if digest not in young]
        garbage.rows = len(unused)
        for digests in chunks(unused if garbage.removed else [], TOGETHER):
            with database.write() as session:
                StoredFileRepository(session).forget(digests)
        left = left_over(store, at_work, min(until, time.time() - SHORTEST_S))
        garbage.leftovers = len(left)
        for path in left if garbage.removed else []:
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
    return garbage


def _files(
    database: Database, store: BlobStore, garbage: Garbage, until: float, steps: Steps
) -> set[str]:
    """Count or remove unused files; returns the digests of those that stay."""
    listed = list(store.files())
    with database.read() as session:
        used = {file.sha256 for file in StoredFileRepository(session).of_frames()}
        used |= {file.sha256 for file in StoredFileRepository(session).of_exports()}
    unused = [file for file in listed if file.digest not in used]
    old = [file for file in unused if file.modified_at <= until]
    young = {file.digest for file in unused if file.modified_at > until}
    garbage.too_young = len(young)
    if not garbage.removed:
        garbage.files = len(old)
        garbage.size_bytes = sum(file.size_bytes for file in old)
        return young
    done = 0
    with steps("remove", "files") as advance:
        for digests in chunks([file.digest for file in old], TOGETHER):
            with database.write() as session:
                # The first statement takes the turn to write: no other transaction can
                # commit.
                keep_turn(session)
                referred_to = StoredFileRepository(session).referred_to(digests)
                left = [digest for digest in digests if digest not in referred_to]
                removed = store.remove(left, unused_since=until)
            garbage.too_young += len(left) - len(removed)
            garbage.files += len(removed)
            garbage.size_bytes += sum(removed.values())
            young |= set(digests) - removed.keys()
            done += len(digests)
            advance(done, len(old))
    return young
