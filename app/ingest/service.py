"""A frame on its way in: checked, measured, stored; one alone or many together."""

from __future__ import annotations

import hashlib
import json
import logging
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.boxes.current import DecisionRepository
from app.context import ServiceContext
from app.errors import (
    AppError,
    Forbidden,
    FrameConflict,
    StorageFull,
    TooLarge,
    Unprocessable,
)
from app.incoming import in_turn, is_large
from app.ingest.files import CheckedFiles, check_files, checked_key
from app.ingest.rows import FrameContent, describe_new, write_frames
from app.ingest.tar import IncomingFrame
from app.measuring.active import ActiveDataset, PlanCache
from app.measuring.pixels import MEASURED, SENSORS, measure_files, naming
from app.measuring.queries import DatasetRepository, KeyRow, key_rows, note_problem
from app.security import Principal
from app.settings import Settings
from app.storage import Drafts
from app.storage.room import require_room
from filter_core.annotation.frame import AnnotationLimits, FrameAnnotation
from filter_core.annotation.parsing import parse_annotation, without_key
from filter_core.errors import AnnotationError, FilterError
from filter_core.formats.reading import MAX_KEY
from filter_core.pipeline import MeasuredFrame
from filter_core.types import Reason, Verdict
from unghost.wire.datasets import VerdictCounts

_OF_ONE_FRAME: Final = (
    FilterError,
    Forbidden,
    FrameConflict,
    TooLarge,
    Unprocessable,
)
"""What is wrong with one frame; anything else ends the batch."""

log = logging.getLogger(__name__)

MAX_TEXT: Final = 200
"""Characters of an id, a class or a map: what their columns hold."""
_CANONICAL: Final = json.JSONEncoder(sort_keys=True, separators=(",", ":"))
_DIGEST_OF: Final = b"frame 1\n"
"""Begins every content digest, should its definition ever change."""


@dataclass(frozen=True)
class UploadedFrame:
    """A frame as it was sent."""

    key: str
    annotation: bytes | Mapping[str, Any]
    files: Mapping[str, bytes]
    sender: Principal
    replace: bool = False
    annotation_bytes: int = 0
    """Of its JSON, where the annotation has been read already."""

    @property
    def json_bytes(self) -> int:
        """How large the annotation was when it came."""
        is_read = isinstance(self.annotation, Mapping)
        return self.annotation_bytes if is_read else len(self.annotation)


@dataclass(frozen=True)
class CheckedFrame:
    """A frame whose annotation and headers are in order."""

    upload: UploadedFrame
    annotation: FrameAnnotation
    files: CheckedFiles
    digest: str


class MeasuredOtherwise(Exception):
    """A run changed what frames are measured with since this one was measured.

    It is raised in the transaction that would store the frame, which ends: pixels are
    never read while others wait to write. Then the frame is measured again.
    """


@dataclass(frozen=True)
class ReadyFrame:
    """A frame of which only the rows are missing."""

    prepared: CheckedFrame
    measured: MeasuredFrame
    measured_for: ActiveDataset

    @property
    def key(self) -> str:
        """The frame's key."""
        return self.prepared.upload.key

    def is_for(self, active: ActiveDataset) -> bool:
        """Whether it was measured as the dataset asks for by now."""
        return active.row.measurement_digest == self.measured_for.row.measurement_digest

    def content(self, active: ActiveDataset) -> FrameContent:
        """What is stored; MeasuredOtherwise if it is not for this dataset as it is."""
        prepared = self.prepared
        if not self.is_for(active):
            raise MeasuredOtherwise(self.key)
        return FrameContent(
            key=prepared.upload.key,
            digest=prepared.digest,
            sender=prepared.upload.sender,
            annotation=prepared.annotation,
            files=prepared.files,
            measured=self.measured,
        )


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
    upload: UploadedFrame,
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
    with _noting(context, name, upload.key):
        ready = received(context, name, upload, given_up)
    if isinstance(ready, ReadyFrame):
        context.storage.put(ready.prepared.files.blobs())
    return ready


@contextmanager
def _noting(context: ServiceContext, name: str, key: str) -> Iterator[None]:
    """Note what is wrong with a frame among its dataset's problems.

    In a transaction of its own: what the frame's own one wrote is rolled back.
    """
    try:
        yield
    except FilterError as error:
        with context.database.write() as session:
            active = context.one(PlanCache).active(session, name)
            note_problem(session, active.row.dataset_id, key, error)
        raise


def store_frame(
    context: ServiceContext, name: str, ready: ReadyFrame | int
) -> StoredFrame:
    """Store the rows of a frame from `prepare_frame`, all or none, and commit.

    Raises
    ------
    FilterError
        It had to be measured again, and that failed; it is noted as a problem.
    FrameConflict
        Meanwhile another frame has got this key.
    """
    if isinstance(ready, int):
        return StoredFrame(ready, created=False)
    while True:
        try:
            with context.database.write() as session:
                return _store_rows(context, session, name, ready)
        except MeasuredOtherwise:
            with _noting(context, name, ready.key):
                ready = measured_again(context, name, ready)


def _store_rows(
    context: ServiceContext, session: Session, name: str, ready: ReadyFrame
) -> StoredFrame:
    active, known = context.one(PlanCache).active_and_key(session, name, ready.key)
    same = stored_already(known, ready.prepared, name)
    if same is not None:
        return StoredFrame(same, created=False)
    content = ready.content(active)
    # Who collects garbage has its turn as a writer: what is there now stays there.
    context.storage.require(file.sha256 for file in content.files.rows)
    (written,) = write_frames(session, active, [(content, known)])
    describe = partial(describe_new, active, content, written)
    return StoredFrame(written.frame_id, created=True, describe=describe)


def received(
    context: ServiceContext,
    dataset: str,
    upload: UploadedFrame,
    given_up: threading.Event | None = None,
) -> ReadyFrame | int:
    """A frame that is ready to be stored, or the id that it is stored under already.

    Raises
    ------
    FilterError
        What is wrong with the frame.
    FrameConflict
        Another frame has its key.
    app.engine.pixels.GivenUp
        `given_up` was set while a child process measured it.
    """
    active, known = context.one(PlanCache).before_measuring(
        context.database, dataset, upload.key
    )
    prepared = _prepare(context, upload)
    same = stored_already(known, prepared, dataset)
    if same is None:
        return _make_ready(context, active, prepared, given_up)
    context.storage.mend(prepared.files.blobs())
    return same


def measured_again(context: ServiceContext, name: str, ready: ReadyFrame) -> ReadyFrame:
    """The frame with what its dataset measures by now; no transaction is open."""
    active, _ = context.one(PlanCache).before_measuring(
        context.database, name, ready.key
    )
    if ready.is_for(active):
        return ready
    return _make_ready(context, active, ready.prepared, None)


def stored_already(known: KeyRow, prepared: CheckedFrame, dataset: str) -> int | None:
    """The frame, if it is stored already; FrameConflict if another one has its key."""
    if known.content_digest == prepared.digest:
        return known.frame_id
    if known.frame_id is None or prepared.upload.replace:
        return None
    raise FrameConflict(
        f"dataset {dataset!r} has another frame {prepared.upload.key!r}; "
        "send ?replace=true to store this one as its next revision"
    )


def _prepare(context: ServiceContext, upload: UploadedFrame) -> CheckedFrame:
    """Read the annotation and the headers of the files; nothing is decoded yet."""
    settings, size = context.settings, upload.json_bytes
    with in_turn(size):
        annotation = parse_annotation(
            upload.annotation,
            limits=annotation_limits(settings),
            frame=upload.key,
        )
    with naming(upload.key):
        files = check_files(upload.files, annotation, settings)
    with in_turn(size):
        digest = _content_digest(annotation, files, is_large=is_large(size))
    return CheckedFrame(upload, annotation, files, digest)


def _make_ready(
    context: ServiceContext,
    active: ActiveDataset,
    prepared: CheckedFrame,
    given_up: threading.Event | None,
) -> ReadyFrame:
    """Measure a frame, and refuse a class that the dataset cannot take any more."""
    measured = _measure(context, active, prepared, given_up)
    if active.row.classes_are_frozen:
        _check_classes(context, active, prepared, measured)
    return ReadyFrame(prepared, measured, active)


def _measure(
    context: ServiceContext,
    active: ActiveDataset,
    prepared: CheckedFrame,
    given_up: threading.Event | None = None,
) -> MeasuredFrame:
    plan = active.plan
    files = prepared.files.measured(plan.files)
    with naming(prepared.upload.key, "/segmentation"):
        return measure_files(context.pixels, plan, prepared.annotation, files, given_up)


def _check_classes(
    context: ServiceContext,
    active: ActiveDataset,
    prepared: CheckedFrame,
    measured: MeasuredFrame,
) -> None:
    """Frozen classes take no other one; said here, it is noted as a problem."""
    with context.database.read() as session:
        known = DatasetRepository(session).classes(active.row.dataset_id)
    names = measured.evidence.class_names
    for box, index in zip(
        prepared.annotation.boxes, measured.evidence.class_index.tolist(), strict=True
    ):
        if names[index] not in known:
            raise AnnotationError(
                f"frame {prepared.upload.key}, box {box.index} (id {box.id!r}): "
                f"the classes of dataset {active.name!r} are frozen by an export; "
                f"expected one of {', '.join(known)}, found {names[index]!r}",
                pointer=f"/boxes/{box.index}",
                code="unknown_class",
            )


def _content_digest(
    annotation: FrameAnnotation, files: CheckedFiles, *, is_large: bool
) -> str:
    """Names what was sent: the files' bytes, and the annotation's meaning."""
    digest = hashlib.sha256(_DIGEST_OF)
    for file in files.rows:
        digest.update(f"{file.kind} {file.sha256}\n".encode())
    if is_large:
        # In pieces: no other thread runs while a document is written in one.
        for piece in _CANONICAL.iterencode(annotation.raw):
            digest.update(piece.encode())
    else:
        digest.update(_CANONICAL.encode(annotation.raw).encode())
    return digest.hexdigest()


def annotation_limits(settings: Settings) -> AnnotationLimits:
    """What an annotation may hold."""
    return AnnotationLimits(
        max_boxes=settings.max_boxes_per_frame,
        max_text=MAX_TEXT,
        max_bytes=int(settings.max_json_bytes),
    )


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
    """What became of a frame."""

    key: str
    frame_id: int | None = None
    created: bool = False
    verdicts: VerdictCounts | None = None
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
        upload = UploadedFrame(
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
    light = CheckedFrame(upload, prepared.annotation, files, prepared.digest)
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
    while True:
        try:
            return _store_together(context, batch, works)
        except MeasuredOtherwise:
            works = [_work_again(context, batch, work) for work in works]


def _work_again(context: ServiceContext, batch: BatchOf, work: FrameWork) -> FrameWork:
    if work.ready is None:
        return work
    try:
        return replace(work, ready=measured_again(context, batch.dataset, work.ready))
    except FilterError as error:
        return FrameWork(work.key, error=error)


def _store_together(
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
            new.append((frame.content(active), known[frame.key]))
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


def verdict_counts(reasons: Sequence[int]) -> VerdictCounts:
    """How many boxes have each verdict."""
    counts = {verdict.value: 0 for verdict in Verdict}
    for reason in reasons:
        counts[Reason(reason).verdict.value] += 1
    return VerdictCounts(**counts)
