"""Taking in a frame: checked, measured, decided, and durable before it is answered."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from sqlalchemy.orm import Session

from app.db.tables import Problem
from app.repositories.frames import FrameRepository
from app.repositories.runs import ProblemRepository
from app.services.context import ServiceContext
from app.services.frame_answer import describe_new
from app.services.frame_rows import write_frames
from app.services.incoming import (
    FrameUpload,
    ReadyFrame,
    received,
    stored_already,
)
from app.services.refusals import described
from filter_core.errors import FilterError

__all__ = ["FrameUpload", "StoredFrame", "note_problem", "store_frame"]


@dataclass(frozen=True)
class StoredFrame:
    """Where an upload ended: `created` is False for what was there already.

    `answer` describes a frame that is new, without asking the database for it.
    """

    frame_id: int
    created: bool
    answer: dict[str, Any] | None = None


def store_frame(
    context: ServiceContext, session: Session, name: str, upload: FrameUpload
) -> StoredFrame:
    """Store one frame whole, or raise and store nothing.

    The pixels are measured before the transaction begins, so frames are decoded in
    parallel and only their rows wait for each other.

    Raises
    ------
    FilterError
        What is wrong with the frame; it is noted among the dataset's problems.
    FrameConflict
        Another frame has this key, and `replace` was not asked for.
    """
    try:
        ready = received(context, name, upload)
    except FilterError as error:
        with context.database.write() as noting:
            active = context.plans.active(noting, name)
            note_problem(noting, active.row.dataset_id, upload.key, error)
        raise
    if isinstance(ready, int):
        return StoredFrame(ready, created=False)
    context.storage.put(ready.prepared.files.blobs())
    return _insert(context, session, name, ready)


def note_problem(
    session: Session, dataset_id: int, key: str, error: FilterError
) -> None:
    """Remember a refusal, so that nobody has to search for a missing frame."""
    FrameRepository(session).forget_problems(dataset_id, key)
    ProblemRepository(session).add(
        Problem(dataset_id=dataset_id, key=key, error=described(error))
    )


def _insert(
    context: ServiceContext, session: Session, name: str, ready: ReadyFrame
) -> StoredFrame:
    active, known = context.plans.active_and_key(session, name, ready.key)
    same = stored_already(known, ready.prepared, name)
    if same is not None:
        return StoredFrame(same, created=False)
    content = ready.content(active)
    # Who collects garbage has its turn as a writer: what is there now stays there.
    context.storage.require(file.sha256 for file in content.files.rows)
    (written,) = write_frames(session, active, [(content, known)])
    answer = None if known.frame_id else describe_new(active, content, written)
    return StoredFrame(written.frame_id, created=True, answer=answer)
