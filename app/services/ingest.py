"""Taking in a frame: checked, measured, decided, and durable before it is answered."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.services.active import PlanCache
from app.services.frame_answer import describe_new
from app.services.frame_rows import write_frames
from app.services.incoming import (
    FrameUpload,
    ReadyFrame,
    received,
    stored_already,
)
from app.services.refusals import note_problem
from filter_core.errors import FilterError

__all__ = ["FrameUpload", "StoredFrame", "prepare_frame", "store_frame"]


@dataclass(frozen=True)
class StoredFrame:
    """Where an upload ended: `created` is False for what was there already.

    `describe` is the answer for a frame that is new, without asking the database: to be
    made when others may write again.
    """

    frame_id: int
    created: bool
    describe: Callable[[], dict[str, Any]] | None = None


def prepare_frame(
    context: ServiceContext,
    name: str,
    upload: FrameUpload,
    given_up: threading.Event | None = None,
) -> ReadyFrame | int:
    """Check and measure a frame and store its files: all but its rows.

    No transaction is open meanwhile, so frames are measured in parallel and nobody
    waits for a frame that takes long.

    Returns
    -------
    ReadyFrame, or the id of the frame that is stored already

    Raises
    ------
    FilterError
        What is wrong with the frame; it is noted among the dataset's problems.
    FrameConflict
        Another frame has this key, and `replace` was not asked for.
    app.engine.pixels.GivenUp
        `given_up` was set while a child process measured it: nothing is stored.
    """
    try:
        ready = received(context, name, upload, given_up)
    except FilterError as error:
        with context.database.write() as noting:
            active = context.one(PlanCache).active(noting, name)
            note_problem(noting, active.row.dataset_id, upload.key, error)
        raise
    if isinstance(ready, ReadyFrame):
        context.storage.put(ready.prepared.files.blobs())
    return ready


def store_frame(
    context: ServiceContext, session: Session, name: str, ready: ReadyFrame | int
) -> StoredFrame:
    """Store the rows of a frame from `prepare_frame`: all of them, or none.

    Raises
    ------
    FrameConflict
        Meanwhile another frame has got this key.
    """
    if isinstance(ready, int):
        return StoredFrame(ready, created=False)
    active, known = context.one(PlanCache).active_and_key(session, name, ready.key)
    same = stored_already(known, ready.prepared, name)
    if same is not None:
        return StoredFrame(same, created=False)
    content = ready.content(context, active)
    # Who collects garbage has its turn as a writer: what is there now stays there.
    context.storage.require(file.sha256 for file in content.files.rows)
    (written,) = write_frames(session, active, [(content, known)])
    describe = partial(describe_new, active, content, written)
    return StoredFrame(written.frame_id, created=True, describe=describe)
