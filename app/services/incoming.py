"""A frame on its way in: read, checked and measured, with no transaction open."""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from app.context import ServiceContext
from app.errors import FrameConflict
from app.incoming import in_turn, is_large
from app.repositories.active import KeyRow
from app.repositories.datasets import DatasetRepository
from app.security import Principal
from app.services.active import ActiveDataset, PlanCache
from app.services.frame_files import CheckedFiles, check_files
from app.services.frame_rows import FrameContent
from app.services.measuring import measure_files
from app.services.refusals import naming
from app.settings import Settings
from filter_core.annotation.frame import AnnotationLimits, FrameAnnotation
from filter_core.annotation.parsing import parse_annotation
from filter_core.errors import AnnotationError
from filter_core.pipeline import MeasuredFrame

MAX_TEXT: Final = 200
"""Characters of an id, a class or a map: what their columns hold."""
_CANONICAL: Final = json.JSONEncoder(sort_keys=True, separators=(",", ":"))
_DIGEST_OF: Final = b"frame 1\n"
"""Begins every content digest, should its definition ever change."""


@dataclass(frozen=True)
class FrameUpload:
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
class PreparedFrame:
    """A frame whose annotation and headers are in order."""

    upload: FrameUpload
    annotation: FrameAnnotation
    files: CheckedFiles
    digest: str


@dataclass(frozen=True)
class ReadyFrame:
    """A frame of which only the rows are missing."""

    prepared: PreparedFrame
    measured: MeasuredFrame
    measured_for: ActiveDataset

    @property
    def key(self) -> str:
        """The frame's key."""
        return self.prepared.upload.key

    def content(self, context: ServiceContext, active: ActiveDataset) -> FrameContent:
        """What is stored, measured as the dataset asks for by now.

        A run that was activated in between is rare: it may cost a second measurement.
        """
        prepared, measured = self.prepared, self.measured
        if active.row.measurement_digest != self.measured_for.row.measurement_digest:
            measured = _measure(context, active, prepared)
        return FrameContent(
            key=prepared.upload.key,
            digest=prepared.digest,
            sender=prepared.upload.sender,
            annotation=prepared.annotation,
            files=prepared.files,
            measured=measured,
        )


def received(
    context: ServiceContext,
    dataset: str,
    upload: FrameUpload,
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


def annotation_limits(settings: Settings) -> AnnotationLimits:
    """What an annotation may hold."""
    return AnnotationLimits(
        max_boxes=settings.max_boxes_per_frame,
        max_text=MAX_TEXT,
        max_bytes=int(settings.max_json_bytes),
    )


def _prepare(context: ServiceContext, upload: FrameUpload) -> PreparedFrame:
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
    return PreparedFrame(upload, annotation, files, digest)


def stored_already(known: KeyRow, prepared: PreparedFrame, dataset: str) -> int | None:
    """The frame, if it is stored already; FrameConflict if another one has its key."""
    if known.content_digest == prepared.digest:
        return known.frame_id
    if known.frame_id is None or prepared.upload.replace:
        return None
    raise FrameConflict(
        f"dataset {dataset!r} has another frame {prepared.upload.key!r}; "
        "send ?replace=true to store this one as its next revision"
    )


def _make_ready(
    context: ServiceContext,
    active: ActiveDataset,
    prepared: PreparedFrame,
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
    prepared: PreparedFrame,
    given_up: threading.Event | None = None,
) -> MeasuredFrame:
    plan = active.plan
    files = prepared.files.measured(plan.files)
    with naming(prepared.upload.key, "/segmentation"):
        return measure_files(context.pixels, plan, prepared.annotation, files, given_up)


def _check_classes(
    context: ServiceContext,
    active: ActiveDataset,
    prepared: PreparedFrame,
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
