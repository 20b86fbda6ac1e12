"""SQL for garbage collection and for checks of the database.

It finds used and unused files, deletes the rows of unused ones, and checks answers,
counts and the audit log.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

from sqlalchemy import delete, exists, func, inspect, select, union, union_all

from app.db.base import Repository
from app.db.tables import Blob, Dataset, Decision, Export, FrameFile, Review, Tally
from app.db.tables.access import AuditEntry
from app.verdicts import BIN


class WantedFile(NamedTuple):
    """A blob to which rows refer, and its stored size."""

    sha256: str
    size_bytes: int | None


_HAS_FRAME: Final = exists().where(FrameFile.sha256 == Blob.sha256)


class StoredFileRepository(Repository):
    """Rows about blobs."""

    def of_frames(self) -> Iterator[WantedFile]:
        """Files of frames, of every revision."""
        rows = select(Blob.sha256, Blob.size_bytes).where(_HAS_FRAME)
        for row in self._session.execute(rows):
            yield WantedFile(row[0], row[1])

    def any_of_frames(self) -> bool:
        """Whether any frame has a file."""
        return self._session.scalar(select(FrameFile.sha256).limit(1)) is not None

    def of_exports(self) -> Iterator[WantedFile]:
        """Files of exports that are done."""
        rows = select(Export.sha256, Export.size_bytes).where(
            Export.state == "done", Export.sha256.is_not(None)
        )
        for row in self._session.execute(rows):
            yield WantedFile(str(row[0]), row[1])

    def referred_to(self, digests: Sequence[str]) -> set[str]:
        """Which of the given blobs a frame or an export refers to."""
        frames = select(FrameFile.sha256).where(FrameFile.sha256.in_(digests))
        exports = select(Export.sha256).where(
            Export.sha256.in_(digests), Export.state == "done"
        )
        there = {*self._session.scalars(frames), *self._session.scalars(exports)}
        return {digest for digest in there if digest is not None}

    def unused_rows(self) -> list[str]:
        """Blobs that have a row, but no frame."""
        return list(self._session.scalars(select(Blob.sha256).where(~_HAS_FRAME)))

    def forget(self, digests: Sequence[str]) -> None:
        """Delete the rows of blobs that no frame has."""
        rows = delete(Blob).where(Blob.sha256.in_(digests), ~_HAS_FRAME)
        self._session.execute(rows)

    def open_exports(self) -> set[int]:
        """Exports that are being written, or will be."""
        rows = select(Export.id).where(Export.state.in_(("queued", "running")))
        return set(self._session.scalars(rows))


_MARK: Final = re.compile(r"(\d{1,18}):([0-9a-f]{64})")
_AT_A_TIME: Final = 1000


class AuditMark(NamedTuple):
    """How many entries the audit log has, and the SHA-256 of their content."""

    entries: int
    sha256: str

    @classmethod
    def read(cls, text: str) -> AuditMark:
        """The mark of a text that `str` gave; ValueError if it is none."""
        parts = _MARK.fullmatch(text)
        if parts is None:
            raise ValueError(
                "expected COUNT:SHA256, as `unghost backup` and `unghost doctor` "
                f"print it, found {text[:80]!r}"
            )
        return cls(int(parts[1]), parts[2])

    def __str__(self) -> str:
        return f"{self.entries}:{self.sha256}"


class RowChecks(Repository):
    """Compares rows with others that follow from them, or that were noted elsewhere."""

    def has_audit_log(self) -> bool:
        """Whether there is an audit log: earlier schemas have none."""
        return inspect(self._session.connection()).has_table(AuditEntry.__tablename__)

    def audit_mark(self, most: int | None = None) -> AuditMark:
        """The mark of the audit log, or of its first `most` entries."""
        columns = (
            *(AuditEntry.id, AuditEntry.token_id, AuditEntry.actor),
            *(AuditEntry.action, AuditEntry.subject, AuditEntry.details),
            AuditEntry.created_at,
        )
        rows = select(*columns).order_by(AuditEntry.id).limit(most)
        digest, entries = hashlib.sha256(), 0
        for row in self._session.execute(rows).yield_per(_AT_A_TIME):
            *values, created_at = row
            line = [*values, created_at.isoformat()]
            digest.update(json.dumps(line, sort_keys=True).encode() + b"\n")
            entries += 1
        return AuditMark(entries, digest.hexdigest())

    def altered_answers(self) -> list[int]:
        """Boxes that lack answers, or whose decision has another than the latest one.

        The answers on a box have the revisions from 1 on, and its decision the last.
        """
        answers = (
            select(
                Review.box_id,
                func.count().label("number"),
                func.max(Review.revision).label("latest"),
            )
            .group_by(Review.box_id)
            .cte("answers")
        )
        gaps = select(answers.c.box_id).where(answers.c.number != answers.c.latest)
        latest = func.coalesce(answers.c.latest, 0)
        behind = (
            select(Decision.box_id)
            .outerjoin(answers, answers.c.box_id == Decision.box_id)
            .where(latest != Decision.revision)
        )
        is_latest = Review.revision == Decision.revision
        others = (
            select(Decision.box_id)
            .join(Review, (Review.box_id == Decision.box_id) & is_latest)
            .where(Review.verdict != func.coalesce(Decision.review, "clear"))
        )
        return sorted(self._session.scalars(union(gaps, behind, others)))

    def altered_counts(self) -> dict[str, int]:
        """By dataset, how many of its tallies are not what its decisions add up to."""
        alike = (
            *(Decision.dataset_id, Decision.class_id, Decision.reason),
            *(Decision.toss_up, BIN),
            func.coalesce(Decision.review, "").label("review"),
        )
        counted = select(*alike, func.count().label("boxes")).group_by(*alike)
        stored = select(
            *(Tally.dataset_id, Tally.class_id, Tally.reason),
            *(Tally.toss_up, Tally.bin, Tally.review, -Tally.boxes),
        )
        both = union_all(counted, stored).subquery()
        *key, boxes = both.c
        wrong = select(*key).group_by(*key).having(func.sum(boxes) != 0).subquery()
        rows = (
            select(Dataset.name, func.count())
            .join(wrong, wrong.c.dataset_id == Dataset.id)
            .where(Dataset.removed_at.is_(None))
            .group_by(Dataset.name)
            .order_by(Dataset.name)
        )
        return {row[0]: row[1] for row in self._session.execute(rows)}
