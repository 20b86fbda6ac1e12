"""Runs: one configuration applied to a whole dataset, in the background.

The work of a run is done outside of any transaction; then one transaction looks for
frames that came in meanwhile, stores what changed, and makes its verdicts current.
Nobody ever sees a dataset that is half decided.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from sqlalchemy.orm import Session

from app.boxes.queries import FrameRepository
from app.context import ServiceContext
from app.db.base import utc_now
from app.db.tables import Chunk, Run
from app.jobs.kind import Task
from app.jobs.queries import Span
from app.measuring.queries import EvidenceRepository
from app.repositories.runs import RunRepository
from app.services.run_measuring import measure_chunk, plan_frames, unmeasured_of
from app.services.run_states import described_run
from app.services.run_switching import decide_all
from unghost.wire import runs as wire


class RunKind:
    """Chunks are frames that lack their numbers; the final step decides all boxes."""

    table = Run
    final_step: str | None = "deciding its boxes"

    def may_begin(self, session: Session, row: Run) -> bool:
        """Whether no earlier run of the dataset is to become active before this one."""
        return not RunRepository(session).has_to_wait(row)

    def begin(self, session: Session, row: Run) -> None:
        """Count the frames, and those that an earlier run has measured already."""
        if row.state == "queued":
            row.total = FrameRepository(session).count(row.dataset_id)
        row.started_at = row.started_at or utc_now()
        missing = EvidenceRepository(session).count_unmeasured(
            row.dataset_id, row.measurement_id or 0
        )
        if missing:
            row.done = max(row.done, row.total - missing)

    def plan(
        self, session: Session, row: Run, *, after: int, most: int, frames: int
    ) -> list[Span]:
        """Chunks of frames that lack their numbers."""
        return plan_frames(session, row, after=after, most=most, frames=frames)

    def work(self, task: Task[Run]) -> None:
        """Measure a chunk."""
        measure_chunk(task)

    def finish(self, task: Task[Run]) -> None:
        """Decide, and end the run, unless frames have come in meanwhile."""
        decide_all(task)

    def left(self, session: Session, row: Run, chunk: Chunk) -> list[int]:
        """Frames of a chunk that lack their numbers."""
        return unmeasured_of(session, row, chunk)

    def name_left(self, session: Session, row: Run, chunks: Sequence[Chunk]) -> str:
        """The frames that lack their numbers, by their keys."""
        left = [unmeasured_of(session, row, chunk) for chunk in chunks]
        ends = sorted({(ids[0], ids[-1]) for ids in left if ids})
        heads = FrameRepository(session).heads({id_ for both in ends for id_ in both})
        keys = {id_: repr(frame.key) for id_, frame in heads.items()}
        named = ", ".join(
            keys[first] if first == last else f"{keys[first]} to {keys[last]}"
            for first, last in ends
        )
        word = "frame" if named in keys.values() else "frames"
        return f"{word} {named}" if named else ""

    def describe(self, context: ServiceContext, session: Session, row: Run) -> wire.Run:
        """A run with the names of what it refers to."""
        return described_run(context, session, row)


RUNS: Final = RunKind()
