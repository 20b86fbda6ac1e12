"""The two halves of storing frames of a batch: each alone, then some together."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.errors import (
    AppError,
    Forbidden,
    FrameConflict,
    StorageFull,
    TooLarge,
    Unprocessable,
)
from app.incoming import in_turn
from app.repositories.active import key_rows
from app.repositories.decisions import DecisionRepository
from app.security import Principal
from app.services.active import ActiveDataset, PlanCache
from app.services.batch_frames import IncomingFrame
from app.services.frame_keys import checked_key
from app.services.frame_rows import write_frames
from app.services.incoming import (
    FrameUpload,
    PreparedFrame,
    ReadyFrame,
    annotation_limits,
    received,
    stored_already,
)
from app.services.pixel_work import MEASURED, SENSORS
from app.services.refusals import note_problem
from app.storage import Drafts
from app.storage.room import require_room
from filter_core.annotation.parsing import without_key
from filter_core.errors import FilterError
from filter_core.formats.reading import MAX_KEY
from filter_core.types import Reason, Verdict

_OF_ONE_FRAME: Final = (
    FilterError,
    Forbidden,
    FrameConflict,
    TooLarge,
    Unprocessable,
)
"""What is wrong with one frame; anything else ends the batch."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class BatchOf:
    """What all frames of a batch have in common."""

    dataset: str
    sender: Principal
    replace: bool


@dataclass(frozen=True)
class FrameWork:
    """A frame on its way: ready to be stored, stored already, or refused."""

    key: str
    ready: ReadyFrame | None = None
    drafts: Drafts | None = None
    frame_id: int | None = None
    error: Exception | None = None

    @property
    def size_bytes(self) -> int:
        """Bytes of files that it keeps."""
        if self.ready is None:
            return 0
        return sum(map(len, self.ready.prepared.files.contents.values()))


@dataclass(frozen=True)
class FrameLine:
    """What became of a frame; `verdicts` are counts by verdict."""

    key: str
    frame_id: int | None = None
    created: bool = False
    verdicts: dict[str, int] | None = None
    error: Exception | None = None


def work_on(context: ServiceContext, batch: BatchOf, frame: IncomingFrame) -> FrameWork:
    """Everything that one frame needs and no other has to wait for."""
    key = frame.name
    try:
        if frame.fault is not None:
            raise frame.fault
        limits = annotation_limits(context.settings)
        size = len(frame.annotation)
        with in_turn(size):
            key, annotation = without_key(frame.annotation, frame.name, limits)
        upload = FrameUpload(
            checked_key(key),
            annotation,
            frame.files,
            batch.sender,
            batch.replace,
            annotation_bytes=size,
        )
        ready = received(context, batch.dataset, upload)
    except _OF_ONE_FRAME as error:
        return FrameWork(key, error=error)
    if isinstance(ready, int):
        return FrameWork(key, frame_id=ready)
    drafts = context.storage.draft(ready.prepared.files.blobs())
    return FrameWork(key, _light(ready), drafts)


def _light(ready: ReadyFrame) -> ReadyFrame:
    """Without the bytes that are on the disk by now and are not measured."""
    prepared = ready.prepared
    contents = prepared.files.contents
    kinds = (*MEASURED, *SENSORS)
    needed = {kind: contents[kind] for kind in kinds if kind in contents}
    files = replace(prepared.files, contents=needed)
    upload = replace(prepared.upload, files={})
    light = PreparedFrame(upload, prepared.annotation, files, prepared.digest)
    return replace(ready, prepared=light)


def store(
    context: ServiceContext, batch: BatchOf, works: Sequence[FrameWork]
) -> list[FrameLine]:
    """Make frames of different keys durable, in one transaction, in their order."""
    drafts = [work.drafts for work in works if work.drafts]
    try:
        require_room(context.settings, context.storage)
    except StorageFull:
        context.storage.discard(drafts)
        raise
    context.storage.settle(drafts)
    try:
        return _store(context, batch, works)
    except (AppError, FilterError, IntegrityError):
        # One of them stands in the way of the others: each by itself, then.
        log.info("a batch is stored frame by frame", exc_info=True)
    return [_store_alone(context, batch, work) for work in works]


def _store_alone(context: ServiceContext, batch: BatchOf, work: FrameWork) -> FrameLine:
    try:
        (line,) = _store(context, batch, [work])
    except _OF_ONE_FRAME as error:
        (line,) = _store(context, batch, [FrameWork(work.key, error=error)])
    return line


def _store(
    context: ServiceContext, batch: BatchOf, works: Sequence[FrameWork]
) -> list[FrameLine]:
    with context.database.write() as session:
        active = context.one(PlanCache).active(session, batch.dataset)
        ready = [work.ready for work in works if work.ready is not None]
        lines = _insert(context, session, active, ready)
        for work in works:
            if work.key not in lines:
                lines[work.key] = _told(session, active, work)
        _count_stored(session, lines)
    return [lines[work.key] for work in works]


def _insert(
    context: ServiceContext,
    session: Session,
    active: ActiveDataset,
    frames: Sequence[ReadyFrame],
) -> dict[str, FrameLine]:
    """Lines of the frames that are stored now, or were by somebody else meanwhile."""
    known = key_rows(session, active.row.dataset_id, [frame.key for frame in frames])
    lines: dict[str, FrameLine] = {}
    new = []
    for frame in frames:
        try:
            same = stored_already(known[frame.key], frame.prepared, active.name)
        except FrameConflict as error:
            lines[frame.key] = FrameLine(frame.key, error=error)
            continue
        if same is None:
            new.append((frame.content(context, active), known[frame.key]))
        else:
            lines[frame.key] = FrameLine(frame.key, same)
    if new:
        context.storage.require(
            file.sha256 for content, _ in new for file in content.files.rows
        )
        written = write_frames(session, active, new)
        for (content, _), row in zip(new, written, strict=True):
            verdicts = verdict_counts(row.decisions.reason.tolist())
            lines[content.key] = FrameLine(content.key, row.frame_id, True, verdicts)
    return lines


def _told(session: Session, active: ActiveDataset, work: FrameWork) -> FrameLine:
    if isinstance(work.error, FilterError):
        # A name in the archive may be longer; no frame has such a key.
        key = work.key[:MAX_KEY]
        note_problem(session, active.row.dataset_id, key, work.error)
    return FrameLine(work.key, work.frame_id, error=work.error)


def _count_stored(session: Session, lines: dict[str, FrameLine]) -> None:
    """Verdicts of the frames that were there already."""
    same = {
        line.frame_id: key
        for key, line in lines.items()
        if line.frame_id is not None and line.verdicts is None
    }
    if not same:
        return
    for frame_id, rows in DecisionRepository(session).per_frame(list(same)).items():
        reasons = [row.reason for row in rows for _ in range(row.boxes)]
        key = same[frame_id]
        lines[key] = replace(lines[key], verdicts=verdict_counts(reasons))


def verdict_counts(reasons: Sequence[int]) -> dict[str, int]:
    """How many boxes have each verdict."""
    counts = {verdict.value: 0 for verdict in Verdict}
    for reason in reasons:
        counts[Reason(reason).verdict.value] += 1
    return counts
