"""Rows of chunks: the parts of a job, and whether each is waiting, done or quarantined.

A job's frames are planned as chunks with the numbers 1, 2, 3 and so on, a few at a
time. A run has one more, its *final step*, which comes after all of them (`JobKind`).
It has the number 0, so that every process finds it without knowing how many chunks are
going to be planned.

`app.jobs.attempts` changes the count of attempts and puts chunks into quarantine.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final, NamedTuple

from sqlalchemy import ColumnElement, delete, func, select, update

from app.db.base import Repository, utc_now
from app.db.bulk import insert_into, insert_rows
from app.db.tables import Chunk
from app.engine.chunk import Job

FINAL_STEP: Final = 0
"""The number of a job's final step, although it comes last."""


class PlannedChunk(NamedTuple):
    """The frames of a chunk to be added: their first and last id, and how many."""

    first_frame_id: int
    last_frame_id: int
    frames: int


class ChunkRepository(Repository):
    """Rows of `chunks`."""

    def plan(self, job: Job, planned: Iterable[PlannedChunk]) -> list[int]:
        """Add chunks to a job; returns their numbers."""
        numbered = dict(enumerate(planned, self._last_number(job) + 1))
        rows = [_row(job, number, chunk) for number, chunk in numbered.items()]
        insert_rows(self._session, Chunk, rows)
        return list(numbered)

    def plan_final_step(self, job: Job, frames: int) -> None:
        """Add a job's final step, unless it exists."""
        row = _row(job, FINAL_STEP, PlannedChunk(0, 0, frames))
        new = insert_into(self._session, Chunk).values(row)
        self._session.execute(new.on_conflict_do_nothing())

    def withdraw_final_step(self, job: Job) -> None:
        """Delete a job's final step, by which its process notices a cancellation."""
        waiting = Chunk.number == FINAL_STEP, Chunk.state == "waiting"
        self._session.execute(delete(Chunk).where(*_chunks_of(job), *waiting))

    def find(self, job: Job, number: int) -> Chunk | None:
        """A chunk, unless its job has been removed."""
        return self._session.get(Chunk, (job.kind, job.id, number))

    def waiting(self, job: Job) -> list[int]:
        """Numbers of the chunks that an earlier driver has planned and not finished.

        Without the final step, which the driver begins itself: there may be new frames
        to process before it.
        """
        rows = select(Chunk.number).where(
            *_chunks_of(job), Chunk.state == "waiting", Chunk.number != FINAL_STEP
        )
        return list(self._session.scalars(rows.order_by(Chunk.number)))

    def quarantined(self, job: Job) -> list[Chunk]:
        """Chunks that are not retried any more."""
        rows = select(Chunk).where(*_chunks_of(job), Chunk.state == "quarantined")
        return list(self._session.scalars(rows.order_by(Chunk.number)))

    def planned_up_to(self, job: Job) -> int:
        """The id of the frame after which new chunks begin; 0: with the first frame.

        New chunks are made of frames without a result. But the frames of a chunk that
        waits, or is in quarantine, have no result either, and must not be in a second
        chunk. So if there is such a chunk, new ones begin after the last frame of all
        chunks.
        """
        if not (self.waiting(job) or self.quarantined(job)):
            return 0
        rows = select(func.max(Chunk.last_frame_id)).where(*_chunks_of(job))
        return self._session.scalar(rows) or 0

    def has_chunks(self, job: Job) -> bool:
        return self._last_number(job) > 0

    def mark_done(self, job: Job, number: int) -> None:
        """Mark a chunk as done; idempotent."""
        rows = update(Chunk).where(*_chunks_of(job), Chunk.number == number)
        done = {"state": "done", "error": None, "finished_at": utc_now()}
        self._session.execute(rows.where(Chunk.state == "waiting").values(**done))

    def fail(self, job: Job, number: int, error: Mapping[str, object]) -> None:
        """Store the error with which the job has to fail."""
        rows = update(Chunk).where(*_chunks_of(job), Chunk.number == number)
        self._session.execute(rows.values(error=dict(error)))

    def clear_errors(self, job: Job) -> None:
        """Clear errors of waiting chunks, which an earlier driver has not reported."""
        failed = Chunk.state == "waiting", Chunk.error.is_not(None)
        rows = update(Chunk).where(*_chunks_of(job), *failed)
        self._session.execute(rows.values(error=None))

    def forget(self, job: Job, *, keep_quarantined: bool) -> None:
        """Delete the chunks of a job that has ended."""
        rows = delete(Chunk).where(*_chunks_of(job))
        if keep_quarantined:
            rows = rows.where(Chunk.state != "quarantined")
        self._session.execute(rows)

    def _last_number(self, job: Job) -> int:
        rows = select(func.max(Chunk.number)).where(*_chunks_of(job))
        return self._session.scalar(rows) or 0


def _row(job: Job, number: int, chunk: PlannedChunk) -> dict[str, object]:
    return {
        "kind": job.kind,
        "job_id": job.id,
        "number": number,
        **chunk._asdict(),
        "state": "waiting",
        "attempts": 0,
        "error": None,
        "finished_at": None,
    }


def _chunks_of(job: Job) -> list[ColumnElement[bool]]:
    return [Chunk.kind == job.kind, Chunk.job_id == job.id]
