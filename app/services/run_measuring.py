"""The part of a run that makes numbers: from pixels, or from tag histograms."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Protocol

from sqlalchemy.orm import Session

from app.db.tables import Frame
from app.engine import Job
from app.repositories.datasets import DatasetRepository
from app.repositories.evidence import EvidenceRepository
from app.repositories.frames import FileRow, FrameRepository
from app.services.context import ServiceContext
from app.services.measuring import (
    MEASURED,
    FrameFiles,
    MeasurePlan,
    measure_files,
    packed,
    plan_of,
)
from app.services.recounting import recount, recounted_row
from app.services.refusals import naming
from app.services.run_states import run_at_work
from filter_core.annotation import parse_annotation
from filter_core.config import FilterConfig

CHUNK: Final = 200
"""Frames whose rows are read at a time."""
COMMIT_EVERY_S: Final = 0.25
"""How much work a crash may cost, and how often progress is seen to move."""


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
    @property
    def job(self) -> Job: ...


@dataclass(frozen=True)
class _Source:
    """How the frames of one chunk are measured."""

    plan: MeasurePlan
    classes: Mapping[str, int]
    measurement_id: int
    former_measurement_id: int
    needs_pixels: bool


def measure_missing(context: ServiceContext, scope: Scope) -> None:
    """Make the numbers that are not there yet."""
    context.engine.check(scope.job)
    while _measure_chunk(context, scope):
        context.engine.check(scope.job)


def is_measured(session: Session, scope: Scope) -> bool:
    """True if no frame lacks its numbers: none has come in since they were made."""
    return not _missing(session, scope, limit=1)


def _missing(session: Session, scope: Scope, *, limit: int) -> list[int]:
    return EvidenceRepository(session).unmeasured_frames(
        scope.dataset_id, scope.measurement_id, limit=limit
    )


def _measure_chunk(context: ServiceContext, scope: Scope) -> bool:
    with context.database.read() as session:
        missing = _missing(session, scope, limit=CHUNK)
        if not missing:
            return False
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

    with closing(context.engine.map(work, missing)) as measured:
        # When the service stops, what is measured by then is kept for the next start.
        wanted = partial(context.engine.check_wanted, scope.job)
        for rows in _portions(measured, wanted):
            _keep(context, scope, rows)
    return True


def _portions(
    rows: Iterable[dict[str, Any]], check: Callable[[], None]
) -> Iterator[list[dict[str, Any]]]:
    """What was measured in each quarter of a second."""
    portion: list[dict[str, Any]] = []
    begun = time.monotonic()
    for row in rows:
        check()
        portion.append(row)
        if time.monotonic() - begun >= COMMIT_EVERY_S:
            yield portion
            portion, begun = [], time.monotonic()
    if portion:
        yield portion


def _keep(context: ServiceContext, scope: Scope, rows: list[dict[str, Any]]) -> None:
    """Store numbers and count them in one transaction: nothing is measured twice."""
    with context.database.write() as session:
        run = run_at_work(session, scope.run_id)
        # A frame may have been replaced or deleted while it was measured.
        known = FrameRepository(session).existing([row["frame_id"] for row in rows])
        EvidenceRepository(session).add(
            [row for row in rows if row["frame_id"] in known]
        )
        run.done = min(run.total, run.done + len(rows))


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
    contents = {
        kind: context.storage.read(files[kind].sha256)
        for kind in (*MEASURED, *source.plan.files)
        if kind in files
    }
    annotation = parse_annotation(frame.annotation, frame=frame.key)
    size = (frame.width or 0, frame.height or 0)
    pixels = FrameFiles.of(contents, size)
    with naming(frame.key, "/segmentation"):
        measured = measure_files(source.plan, annotation, pixels)
    ids = [source.classes[name] for name in measured.evidence.class_names]
    return {
        "frame_id": frame.id,
        "measurement_id": source.measurement_id,
        **packed(measured, ids),
    }
