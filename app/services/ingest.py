"""Taking in a frame: checked, measured, decided, and durable before it is answered."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy.orm import Session

from app.db.tables import Problem
from app.errors import FrameConflict
from app.repositories.datasets import DatasetRepository
from app.repositories.frames import FrameRepository
from app.repositories.runs import ProblemRepository
from app.services.active import ActiveDataset
from app.services.context import ServiceContext
from app.services.frame_answer import describe_new
from app.services.frame_files import CheckedFiles, check_files
from app.services.frame_rows import FrameContent, write_frame
from app.services.measuring import measure_files
from app.services.refusals import described, naming
from filter_core.annotation import AnnotationLimits, parse_annotation
from filter_core.annotation_types import FrameAnnotation
from filter_core.errors import AnnotationError, FilterError
from filter_core.frame_filter import MeasuredFrame

MAX_TEXT: Final = 200
"""Characters of an id, a class or a map: what their columns hold."""
_DIGEST_OF: Final = b"frame 1\n"
"""Begins every content digest, should its definition ever change."""


@dataclass(frozen=True)
class FrameUpload:
    """A frame as it was sent."""

    key: str
    annotation: bytes
    files: Mapping[str, bytes]
    sender: str
    replace: bool = False


@dataclass(frozen=True)
class StoredFrame:
    """Where an upload ended: `created` is False for what was there already.

    `answer` describes a frame that is new, without asking the database for it.
    """

    frame_id: int
    created: bool
    answer: dict[str, Any] | None = None


@dataclass(frozen=True)
class _Prepared:
    """A frame whose annotation and headers are in order."""

    upload: FrameUpload
    annotation: FrameAnnotation
    files: CheckedFiles
    digest: str


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
    with context.database.read() as reading:
        active = context.plans.active(reading, name)
        known = FrameRepository(reading).content(active.row.dataset_id, upload.key)
    try:
        prepared = _prepare(context, upload)
        same = _same(known, prepared, name)
        if same is not None:
            return StoredFrame(same, created=False)
        measured = _measure(active, prepared)
        if active.row.classes_are_frozen:
            _check_classes(context, active, prepared, measured)
    except FilterError as error:
        note_problem(context, active.row.dataset_id, upload.key, error)
        raise
    context.storage.put(prepared.files.blobs())
    return _insert(context, session, active, (prepared, measured))


def note_problem(
    context: ServiceContext, dataset_id: int, key: str, error: FilterError
) -> None:
    """Remember a refusal, so that nobody has to search for a missing frame."""
    with context.database.write() as session:
        FrameRepository(session).forget_problems(dataset_id, key)
        ProblemRepository(session).add(
            Problem(dataset_id=dataset_id, key=key, error=described(error))
        )


def _prepare(context: ServiceContext, upload: FrameUpload) -> _Prepared:
    """Read the annotation and the headers of the files; nothing is decoded yet."""
    settings = context.settings
    annotation = parse_annotation(
        upload.annotation,
        limits=AnnotationLimits(settings.max_boxes_per_frame, max_text=MAX_TEXT),
        frame=upload.key,
    )
    with naming(upload.key):
        files = check_files(upload.files, annotation, settings)
    return _Prepared(upload, annotation, files, _content_digest(annotation, files))


def _same(
    known: tuple[int, str] | None, prepared: _Prepared, dataset: str
) -> int | None:
    """The frame, if it is stored already; FrameConflict if another one has its key."""
    if known is None:
        return None
    frame_id, digest = known
    if digest == prepared.digest:
        return frame_id
    if prepared.upload.replace:
        return None
    raise FrameConflict(
        f"dataset {dataset!r} has another frame {prepared.upload.key!r}; "
        "send ?replace=true to store this one as its next revision"
    )


def _measure(active: ActiveDataset, prepared: _Prepared) -> MeasuredFrame:
    with naming(prepared.upload.key, "/segmentation"):
        return measure_files(
            active.plan, prepared.annotation, prepared.files.measured()
        )


def _check_classes(
    context: ServiceContext,
    active: ActiveDataset,
    prepared: _Prepared,
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


def _insert(
    context: ServiceContext,
    session: Session,
    measured_for: ActiveDataset,
    work: tuple[_Prepared, MeasuredFrame],
) -> StoredFrame:
    prepared, measured = work
    active = context.plans.active(session, measured_for.name)
    known = FrameRepository(session).content(active.row.dataset_id, prepared.upload.key)
    same = _same(known, prepared, active.name)
    if same is not None:
        return StoredFrame(same, created=False)
    if active.row.measurement_digest != measured_for.row.measurement_digest:
        # A run was activated in between: rare, so it may cost a second measurement.
        measured = _measure(active, prepared)
    content = FrameContent(
        key=prepared.upload.key,
        digest=prepared.digest,
        sender=prepared.upload.sender,
        annotation=prepared.annotation,
        files=prepared.files,
        measured=measured,
    )
    written = write_frame(session, active, content, replaces=known is not None)
    answer = None if known else describe_new(active, content, written)
    return StoredFrame(written.frame_id, created=True, answer=answer)


def _content_digest(annotation: FrameAnnotation, files: CheckedFiles) -> str:
    """Names what was sent: the files' bytes, and the annotation's meaning."""
    digest = hashlib.sha256(_DIGEST_OF)
    for file in files.rows:
        digest.update(f"{file.kind} {file.sha256}\n".encode())
    canonical = json.dumps(annotation.raw, sort_keys=True, separators=(",", ":"))
    digest.update(canonical.encode())
    return digest.hexdigest()
