"""SQL of totals for metrics; none of them scans all boxes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import get_args

from sqlalchemy import func, select

from app.catalog.datasets import is_there
from app.db.base import Repository
from app.db.tables import Blob, Dataset, JobRow, Tally
from unghost.wire.words import JobState


class Totals(Repository):
    """Totals over all datasets; all are cheap except `blobs`."""

    def datasets(self) -> int:
        rows = select(func.count()).select_from(Dataset).where(is_there())
        return self._session.scalar(rows) or 0

    def boxes_by_reason(self) -> dict[int, int]:
        """Current decisions of all datasets, from the tallies."""
        rows = select(Tally.reason, func.sum(Tally.boxes)).group_by(Tally.reason)
        return {row[0]: int(row[1]) for row in self._session.execute(rows)}

    def boxes_by_review(self) -> dict[str, int]:
        """Boxes that people answered on, by their answer."""
        rows = select(Tally.review, func.sum(Tally.boxes)).where(Tally.review != "")
        counts = self._session.execute(rows.group_by(Tally.review))
        return {row[0]: int(row[1]) for row in counts}

    def jobs(self, tables: Iterable[type[JobRow]]) -> dict[tuple[str, str], int]:
        """Jobs by kind and state, including those that have ended."""
        counts: dict[tuple[str, str], int] = {}
        for table in tables:
            kind = table.job_kind
            counts |= {(kind, state): 0 for state in get_args(JobState)}
            rows = (
                select(table.state, func.count())
                .join(Dataset, Dataset.id == table.dataset_id)
                .where(is_there())
                .group_by(table.state)
            )
            for state, count in self._session.execute(rows):
                counts[kind, state] = count
        return counts

    def database_bytes(self) -> int:
        """The size of a PostgreSQL database."""
        rows = select(func.pg_database_size(func.current_database()))
        return self._session.scalar(rows) or 0

    def blobs(self) -> tuple[int, int]:
        """How many files are stored, and how many bytes they have together.

        Scans all rows, which takes a second for millions.
        """
        rows = select(func.count(), func.coalesce(func.sum(Blob.size_bytes), 0))
        files, size_bytes = self._session.execute(rows.select_from(Blob)).one()
        return files, int(size_bytes)
