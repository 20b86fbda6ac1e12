"""The part of a run that makes numbers: from pixels, or from tag histograms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

from sqlalchemy.orm import Session

from app.db.tables import Frame
from app.repositories.datasets import DatasetRepository
from app.repositories.evidence import EvidenceRepository
from app.repositories.frames import FileRow, FrameRepository
from app.repositories.runs import RunRepository
from app.services.context import ServiceContext
from app.services.measuring import (
    FrameFiles,
    MeasurePlan,
    measure_files,
    packed,
    plan_of,
)
from app.services.recounting import recount, recounted_row
from app.services.refusals import naming
from filter_core.annotation import parse_annotation
from filter_core.config import FilterConfig

CHUNK: Final = 200
"""Frames per transaction: a few seconds of pixel work."""


class RunCancelled(Exception):
    """The service is stopping; the run goes on when it starts again."""


class Scope(Protocol):
    """What is measured, and for which run."""

    @property
    def run_id(self) -> int: ...
    @property
    def dataset_id(self) -> int: ...
    @property
    def measurement_id(self) -> int: ...
    @property
    def config(self) -> FilterConfig: ...


@dataclass(frozen=True)
class _Source:
    """How the frames of one chunk are measured."""

    plan: MeasurePlan
    classes: Mapping[str, int]
    measurement_id: int
    former_measurement_id: int
    needs_pixels: bool


def measure_missing(
    context: ServiceContext, scope: Scope, session: Session | None = None
) -> int:
    """Make the numbers that are not there yet; how many frames that were.

    With a session only frames are looked for, so that a transaction which is about to
    switch can tell that nothing came in between.
    """
    if session is not None:
        return len(_missing(session, scope, limit=1))
    measured = 0
    while True:
        if context.engine.stopping.is_set():
            raise RunCancelled
        done = _measure_chunk(context, scope)
        measured += done
        if done == 0:
            return measured


def _missing(session: Session, scope: Scope, *, limit: int) -> list[int]:
    return EvidenceRepository(session).unmeasured_frames(
        scope.dataset_id, scope.measurement_id, limit=limit
    )


def _measure_chunk(context: ServiceContext, scope: Scope) -> int:
    with context.database.read() as session:
        missing = _missing(session, scope, limit=CHUNK)
        if not missing:
            return 0
        source = _source(session, scope)
        frames = FrameRepository(session).with_ids(missing)
        files = FrameRepository(session).files(missing)
        former = EvidenceRepository(session).of_frames(
            missing, source.former_measurement_id
        )

    def work(frame_id: int) -> dict[str, Any]:
        if not source.needs_pixels:
            row = former[frame_id]
            evidence = recount(row, source.classes, source.plan.config)
            return recounted_row(row, evidence, source.classes, source.measurement_id)
        return _remeasured(context, source, frames[frame_id], files[frame_id])

    rows = list(context.engine.map(work, missing))
    with context.database.write() as session:
        # A frame may have been replaced or deleted while it was measured.
        known = FrameRepository(session).existing(missing)
        EvidenceRepository(session).add(
            [row for row in rows if row["frame_id"] in known]
        )
        run = RunRepository(session).with_id(scope.run_id)
        run.done = min(run.total, run.done + len(rows))
    return len(rows)


def _source(session: Session, scope: Scope) -> _Source:
    dataset = DatasetRepository(session).with_id(scope.dataset_id)
    evidence = EvidenceRepository(session)
    former_id = dataset.active_measurement_id or 0
    former = evidence.measurement_with_id(former_id)
    wanted = evidence.measurement_with_id(scope.measurement_id)
    return _Source(
        plan=plan_of(wanted, scope.config),
        classes=DatasetRepository(session).classes(scope.dataset_id),
        measurement_id=scope.measurement_id,
        former_measurement_id=former_id,
        needs_pixels=former.pixel_digest != wanted.pixel_digest,
    )


def _remeasured(
    context: ServiceContext,
    source: _Source,
    frame: Frame,
    files: Mapping[str, FileRow],
) -> dict[str, Any]:
    def read(kind: str) -> bytes | None:
        return context.storage.read(files[kind].sha256) if kind in files else None

    annotation = parse_annotation(frame.annotation, frame=frame.key)
    size = (frame.width or 0, frame.height or 0)
    pixels = FrameFiles(read("segmentation"), size, read("ignore_mask"))
    with naming(frame.key, "/segmentation"):
        measured = measure_files(source.plan, annotation, pixels)
    ids = [source.classes[name] for name in measured.evidence.class_names]
    return {
        "frame_id": frame.id,
        "measurement_id": source.measurement_id,
        **packed(measured, ids),
    }
