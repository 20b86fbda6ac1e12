"""Ingestion of frames: checks and measures each, then stores one or many together."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Final

import numpy as np
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.access.service import require_valid
from app.boxes.current import DecisionRepository
from app.catalog.datasets import DatasetRepository
from app.catalog.frames import KeyRow, ProblemRepository, note_problem
from app.context import ServiceContext
from app.errors import (
    Forbidden,
    FrameConflict,
    StorageFull,
    TooLarge,
    Unauthorised,
    Unprocessable,
)
from app.ingest.check import check_frame, read_key, require_key
from app.ingest.frame import (
    AcceptedFrame,
    EndedFrame,
    PreparedFrame,
    ReadyFrame,
    RefusedFrame,
    UploadedFrame,
    UploadRequest,
)
from app.ingest.rows import insert_frames, verdict_counts
from app.measuring.active import ActiveDataset, PlanCache
from app.measuring.frame_files import MEASURED, SENSORS, FrameFiles, measure_files
from app.storage.base import BlobsUncertain
from app.storage.room import require_room
from filter_core.annotation.frame import FrameAnnotation
from filter_core.annotation.units import check_units
from filter_core.errors import AnnotationError, FilterError, UnghostError, error_context
from filter_core.formats.reading import MAX_KEY
from filter_core.pipeline import MeasuredFrame

_OF_ONE_FRAME: Final = (FilterError, Forbidden, FrameConflict, TooLarge, Unprocessable)
"""Errors that concern one frame only; any other error ends the request."""

log = logging.getLogger(__name__)


def add_frame(
    context: ServiceContext,
    request: UploadRequest,
    upload: UploadedFrame,
    cancelled: threading.Event | None = None,
) -> AcceptedFrame:
    """Check, measure and store one frame, and commit.

    Raises FilterError: the frame is invalid; this is stored as a problem of the
    dataset; FrameConflict: another frame has this key, and `replace` is not set;
    app.engine.children.CallCancelled: `cancelled` was set while a child process
    measured it: nothing is stored.
    """
    frame = prepare_frame(context, request, upload, cancelled)
    if not isinstance(frame, AcceptedFrame):
        (frame,) = store_frames(context, request, [frame])
    if isinstance(frame, RefusedFrame):
        raise frame.error
    return frame


def prepare_frame(
    context: ServiceContext,
    request: UploadRequest,
    upload: UploadedFrame,
    cancelled: threading.Event | None = None,
) -> PreparedFrame:
    """Check and measure one frame and write its files, outside any transaction.

    Pass a ReadyFrame or a RefusedFrame to `store_frames`. If a ReadyFrame is not to be
    stored, pass its drafts to `storage.discard`. An AcceptedFrame is in the dataset
    already.

    Raises app.engine.children.CallCancelled: `cancelled` was set while a child process
    measured it.
    """
    key = upload.key
    try:
        key, raw = read_key(upload, context.settings)
        require_key(key)
        active, key_row = context.one(PlanCache).before_measuring(
            context.database, request.dataset, key
        )
        annotation, wh, rows, digest = check_frame(key, raw, upload, context.settings)
        end = _known_end(key_row, key, digest, request)
        if end is None:
            files = FrameFiles.of(upload.files, wh, active.plan.files)
            work = annotation, files
            measured = _measure(context, active, key, work, cancelled)
    except _OF_ONE_FRAME as error:
        return RefusedFrame(key, error)
    if isinstance(end, RefusedFrame):
        return end
    blobs = {row.sha256: upload.files[row.kind] for row in rows}
    if end is not None:
        context.storage.put_missing(blobs)
        if key_row.has_problem:
            with _writing(context, request) as session:
                ProblemRepository(session).forget(active.row.dataset_id, key)
        return end
    kinds = (*MEASURED, *SENSORS)
    contents = {kind: upload.files[kind] for kind in kinds if kind in upload.files}
    drafts = context.storage.draft(blobs)
    return ReadyFrame(key, rows, contents, digest, measured, active, drafts)


def _known_end(
    key_row: KeyRow, key: str, digest: str, request: UploadRequest
) -> EndedFrame | None:
    """The result for a frame that is stored already, or whose key is taken; or None."""
    if key_row.frame_id is None:
        return None
    if key_row.content_digest == digest:
        return AcceptedFrame(key, key_row.frame_id)
    if request.replace:
        return None
    conflict = FrameConflict(
        f"dataset {request.dataset!r} has another frame {key!r}; "
        "?replace=true stores this one as its next revision"
    )
    return RefusedFrame(key, conflict)


def _measure(
    context: ServiceContext,
    active: ActiveDataset,
    key: str,
    work: tuple[FrameAnnotation, FrameFiles],
    cancelled: threading.Event | None = None,
) -> MeasuredFrame:
    """Measure a frame that comes in.

    Refuses rectangles in another unit, and new classes if the dataset's are frozen:
    before the transaction, so that the error can be stored as a problem.
    """
    plan, (annotation, files) = active.plan, work
    check_units(annotation, files.image_wh, plan.profile, key)
    with error_context(key, "/segmentation"):
        measured = measure_files(context.pixels, plan, annotation, files, cancelled)
    if not active.row.classes_are_frozen:
        return measured
    with context.database.read() as session:
        classes = DatasetRepository(session).listed_classes(active.row.dataset_id)
    names, index = measured.evidence.class_names, measured.evidence.class_index.tolist()
    for box, place in zip(annotation.boxes, index, strict=True):
        if names[place] not in classes:
            raise AnnotationError(
                f"frame {key}, box {box.index} (id {box.id!r}): "
                f"the classes of dataset {active.name!r} are frozen by an export; "
                f"expected one of {', '.join(classes)}, found {names[place]!r}",
                pointer=f"/boxes/{box.index}",
                code="unknown_class",
            )
    return measured


def store_frames(
    context: ServiceContext, request: UploadRequest, frames: Sequence[PreparedFrame]
) -> list[EndedFrame]:
    """Store frames of different keys, in order and in one transaction.

    Errors of refused frames are stored as problems of the dataset. A frame that cannot
    be stored does not prevent storing the others. Raises StorageFull: there is no disk
    space: nothing is stored; Unauthorised: the sender's token or session has ended
    since the request began.
    """
    drafts = [frame.drafts for frame in frames if isinstance(frame, ReadyFrame)]
    try:
        require_room(context.settings, context.storage)
    except StorageFull:
        context.storage.discard(drafts)
        raise
    context.storage.settle(drafts)
    if len(frames) > 1:
        try:
            return _store_together(context, request, frames)
        except Unauthorised:
            raise
        except (UnghostError, IntegrityError):
            # One frame made the transaction fail: store each in its own.
            log.info("a batch is stored frame by frame", exc_info=True)
    ended = []
    for frame in frames:
        try:
            ended += _store_together(context, request, [frame])
        except _OF_ONE_FRAME as error:
            refused = RefusedFrame(frame.key, error)
            ended += _store_together(context, request, [refused])
    return ended


class _MeasuredOtherwise(Exception):
    """A run has changed the measurement since these frames were measured.

    Raised to roll back the transaction, so that no pixel is read while others wait to
    write. Then the frames are measured again.
    """


def _store_together(
    context: ServiceContext, request: UploadRequest, frames: Sequence[PreparedFrame]
) -> list[EndedFrame]:
    while True:
        try:
            with _writing(context, request) as session:
                return _write(context, session, request, frames)
        except _MeasuredOtherwise:
            frames = [_measured_again(context, request, frame) for frame in frames]
        except BlobsUncertain as uncertain:
            context.storage.make_sure(uncertain.digests)


@contextmanager
def _writing(context: ServiceContext, request: UploadRequest) -> Iterator[Session]:
    """A transaction for the sender; Unauthorised if its token has been revoked.

    A batch may be open for hours.
    """
    with context.database.write() as session:
        require_valid(session.connection(), request.sender)
        yield session


def _measured_again(
    context: ServiceContext, request: UploadRequest, frame: PreparedFrame
) -> PreparedFrame:
    """The frame, measured with the current measurement; no transaction is open."""
    if not isinstance(frame, ReadyFrame):
        return frame
    active, _ = context.one(PlanCache).before_measuring(
        context.database, request.dataset, frame.key
    )
    if frame.is_measured_for(active):
        return frame
    before = frame.measured
    files = FrameFiles.of(frame.contents, before.wh, active.plan.files)
    try:
        measured = _measure(context, active, frame.key, (before.annotation, files))
    except FilterError as error:
        return RefusedFrame(frame.key, error)
    return replace(frame, measured=measured, active=active)


def _write(
    context: ServiceContext,
    session: Session,
    request: UploadRequest,
    frames: Sequence[PreparedFrame],
) -> list[EndedFrame]:
    """Write the rows of new frames, and the problems of refused ones."""
    ready = [frame for frame in frames if isinstance(frame, ReadyFrame)]
    active, key_rows = context.one(PlanCache).active_and_keys(
        session, request.dataset, [frame.key for frame in ready]
    )
    ended: dict[str, EndedFrame] = {}
    new = []
    for frame in frames:
        if isinstance(frame, ReadyFrame):  # its key may have been stored meanwhile
            end = _known_end(key_rows[frame.key], frame.key, frame.digest, request)
            if end is None:
                new.append(frame)
                continue
        else:
            end = frame
        if isinstance(end, RefusedFrame) and isinstance(end.error, FilterError):
            # A name in an archive may be longer than any valid key.
            key = frame.key[:MAX_KEY]
            note_problem(session, active.row.dataset_id, key, end.error)
        ended[frame.key] = end
    if not all(frame.is_measured_for(active) for frame in new):
        raise _MeasuredOtherwise
    # Garbage collection waits for its turn to write, so files that exist now stay until
    # this transaction ends.
    context.storage.require(file.sha256 for frame in new for file in frame.files)
    for stored in insert_frames(session, active, request.sender, new, key_rows):
        ended[stored.key] = stored
    return _counted(session, [ended[frame.key] for frame in frames])


def _counted(session: Session, frames: list[EndedFrame]) -> list[EndedFrame]:
    """The frames; those that were stored before get the counts of their verdicts."""
    same = {
        frame.frame_id: place
        for place, frame in enumerate(frames)
        if isinstance(frame, AcceptedFrame) and frame.verdicts is None
    }
    if same:
        tallies = DecisionRepository(session).per_frame(list(same))
        for frame_id, tally in tallies.items():
            reasons = [key.reason for key, boxes in tally.items() for _ in range(boxes)]
            verdicts = verdict_counts(np.array(reasons, np.uint8))
            key = frames[same[frame_id]].key
            frames[same[frame_id]] = AcceptedFrame(key, frame_id, verdicts)
    return frames
