"""The measuring part of a run: computes evidence from pixels or from tag histograms.

Evidence is stored four times a second. If the process dies, whoever continues with the
chunk measures the frames of it that have no evidence yet; a frame that another process
has measured meanwhile is not stored again.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import Final, NamedTuple

from sqlalchemy.orm import Session

from app.boxes.queries import FileRow, FrameRepository
from app.catalog.configs import ConfigRepository
from app.catalog.datasets import DatasetRepository
from app.catalog.frames import note_problem
from app.db.base import filled
from app.db.tables import Chunk, Frame, Run
from app.engine.children import PixelsRefused
from app.engine.chunk import JobStopped
from app.jobs.attempts import is_one_by_one, refuse, refuse_frame
from app.jobs.chunks import ChunkRepository, PlannedChunk
from app.jobs.kind import Task
from app.measuring.active import config_of
from app.measuring.evidence import packed, recount, recounted_row
from app.measuring.frame_files import MEASURED, FrameFiles, measure_files
from app.measuring.plan import plan_of
from app.measuring.queries import EvidenceRepository, EvidenceRow
from filter_core.annotation.parsing import parse_annotation
from filter_core.config.filter import FilterConfig
from filter_core.config.measure import MeasureConfig
from filter_core.errors import FilterError, error_context

_DAMAGED: Final = (
    *("bad_image", "image_size_mismatch", "image_too_large"),
    *("foreign_colors", "lossy_segmentation"),
    *("lossy_depth", "unknown_depth"),
    *("bad_instances", "lossy_instances", "bad_lidar"),
)
"""Errors of a file itself, which an earlier version has stored all the same, or which
was stored before anything needed it. They do not end a run."""
COMMIT_EVERY_S: Final = 0.25
"""Interval of commits, and so of progress.

A crash costs the frames that are being measured and those since the last commit.
"""


@dataclass(frozen=True)
class RunScope:
    """The ids and the configuration of a run, read once.

    `measurement_id` is the measurement to which the run belongs: the evidence of all
    frames of a dataset that were measured in one way (`MeasureConfig`).
    """

    run_id: int
    dataset_id: int
    measurement_id: int
    config: FilterConfig

    @classmethod
    def of(cls, session: Session, run: Run) -> RunScope:
        """The scope of a run's row."""
        config = config_of(ConfigRepository(session).with_id(run.config_id))
        return cls(run.id, run.dataset_id, filled(run.measurement_id), config)


@dataclass(frozen=True)
class _RunChunk:
    """One chunk of a run: its frames without evidence, their rows, how to measure them.

    With `is_one_by_one` each frame is stored before the next one begins, because
    processes have died during this chunk (`app.jobs.attempts`). If `needs_pixels` is
    false, all that is new can be computed from the evidence of the dataset's active
    measurement, `former`; else the images are read. `plan` says what is measured, and
    `classes` are the ids of the dataset's classes.
    """

    scope: RunScope
    is_one_by_one: bool
    missing: list[int]
    plan: MeasureConfig
    classes: Mapping[str, int]
    needs_pixels: bool
    frames: Mapping[int, Frame]
    files: Mapping[int, Mapping[str, FileRow]]
    former: Mapping[int, EvidenceRow]

    @classmethod
    def of(cls, session: Session, task: Task[Run]) -> _RunChunk:
        """The chunk of a task; without frames if it is done."""
        run = task.row(session)
        scope, row = RunScope.of(session, run), task.chunk(session)
        missing = [] if row is None else unmeasured_of(session, run, row)
        evidence, datasets = EvidenceRepository(session), DatasetRepository(session)
        dataset = datasets.with_id(scope.dataset_id)
        former_id = filled(dataset.active_measurement_id)
        former = evidence.measurement_with_id(former_id)
        measurement = evidence.measurement_with_id(scope.measurement_id)
        return cls(
            scope=scope,
            is_one_by_one=row is not None and is_one_by_one(task, row),
            missing=missing,
            plan=plan_of(measurement, scope.config),
            classes=datasets.classes(scope.dataset_id),
            needs_pixels=former.pixel_digest != measurement.pixel_digest,
            frames=FrameRepository(session).with_ids(missing, annotation=True),
            files=FrameRepository(session).files(missing),
            former=evidence.of_frames(missing, former_id),
        )


def plan_frames(
    session: Session, row: Run, *, after: int, most: int, frames: int
) -> list[PlannedChunk]:
    """Up to `most` chunks of frames after an id that have no evidence."""
    missing = EvidenceRepository(session).unmeasured_frames(
        row.dataset_id, filled(row.measurement_id), after=after, limit=most * frames
    )
    chunks = (
        missing[start : start + frames] for start in range(0, len(missing), frames)
    )
    return [PlannedChunk(ids[0], ids[-1], len(ids)) for ids in chunks]


def is_measured(session: Session, scope: RunScope) -> bool:
    """True if all frames have evidence, also those stored during the run."""
    return not EvidenceRepository(session).unmeasured_frames(
        scope.dataset_id, scope.measurement_id, limit=1
    )


def unmeasured_of(session: Session, row: Run, chunk: Chunk) -> list[int]:
    """Frames of a chunk that have no evidence; empty if the chunk is done."""
    if chunk.state == "done":
        return []
    return EvidenceRepository(session).unmeasured_frames(
        row.dataset_id,
        filled(row.measurement_id),
        after=chunk.first_frame_id - 1,
        until=chunk.last_frame_id,
    )


def measure_chunk(task: Task[Run]) -> None:
    """Compute and store the evidence of a chunk's frames that have none.

    Raises JobStopped: it was stopped before the end; what was computed so far is
    stored.
    """
    task.check()
    with task.context.database.read() as session:
        chunk = _RunChunk.of(session, task)
    measured, buffer = 0, _CommitBuffer(task, chunk)
    results = task.context.engine.map(
        partial(_measured, task, chunk), chunk.missing, one_by_one=chunk.is_one_by_one
    )
    with closing(results) as rows:
        for measured_frame in rows:
            # When the service stops, frames that are measured already are stored.
            task.context.engine.check_wanted(task.job)
            measured += 1
            buffer.add(measured_frame, is_last=measured == len(chunk.missing))
    is_whole = measured == len(chunk.missing)
    buffer.commit(is_whole=is_whole)
    if not is_whole:
        raise JobStopped(task.job)


class _Measured(NamedTuple):
    """The row of a frame's evidence.

    `damage` is the error of a damaged file: the frame was measured without that file.
    `refusal` says why nothing was measured: its images cannot be read within the
    limits. Then `row` is empty.
    """

    frame_id: int
    row: dict[str, object]
    key: str = ""
    damage: FilterError | None = None
    refusal: PixelsRefused | None = None


def _measured(task: Task[Run], chunk: _RunChunk, frame_id: int) -> _Measured:
    """Measure a frame: from its former numbers if they suffice, else from its files.

    Damaged files are ignored: an earlier version stored them, which checked less.
    """
    measurement_id = chunk.scope.measurement_id
    if not chunk.needs_pixels:
        row = chunk.former[frame_id]
        evidence = recount(row, chunk.classes, chunk.plan)
        recounted = recounted_row(row, evidence, chunk.classes, measurement_id)
        return _Measured(frame_id, recounted)
    pool, storage = task.context.pixels, task.context.storage
    frame, files = chunk.frames[frame_id], chunk.files[frame_id]
    kinds = [kind for kind in (*MEASURED, *chunk.plan.files) if kind in files]
    usable = task.retry_unavailable(
        lambda: {kind: storage.read(files[kind].sha256) for kind in kinds}
    )
    annotation = parse_annotation(frame.annotation, frame=frame.key)
    damage: FilterError | None = None
    while True:
        pixels = FrameFiles.of(usable, (frame.width, frame.height))
        try:
            with error_context(frame.key, "/segmentation"):
                try:
                    measured = measure_files(pool, chunk.plan, annotation, pixels)
                except PixelsRefused as refusal:
                    return _Measured(frame.id, {}, refusal=refusal)
            break
        except FilterError as fault:
            kind = fault.pointer.strip("/")
            if fault.kind not in _DAMAGED or kind not in usable:
                raise
            damage = damage or fault
            del usable[kind]
            if kind == "ignore_mask":
                # Without it, pixels would count that must be ignored: no file is used.
                usable.clear()
    ids = [chunk.classes[name] for name in measured.evidence.class_names]
    keys = {"frame_id": frame.id, "measurement_id": measurement_id}
    return _Measured(frame.id, {**keys, **packed(measured, ids)}, frame.key, damage)


class _CommitBuffer:
    """Buffers measured frames, and stores those of a quarter of a second together."""

    def __init__(self, task: Task[Run], chunk: _RunChunk) -> None:
        self._task, self._chunk = task, chunk
        self._measured: list[_Measured] = []
        self._refusal: PixelsRefused | None = None
        self._begun = time.monotonic()

    def add(self, measured: _Measured, *, is_last: bool) -> None:
        """Add a frame; the last one waits for the caller's `commit`.

        A frame that cannot be read is put into quarantine: at once if the chunk
        `is_one_by_one`, else together with its chunk, by `commit`.
        """
        if measured.refusal is None:
            self._measured.append(measured)
        elif self._chunk.is_one_by_one:
            task = self._task
            with task.context.database.write() as session:
                task.row(session)
                frame = (measured.frame_id, measured.refusal)
                refuse_frame(session, task.job, task.number, *frame)
                task.reset_attempts(session)
        else:
            self._refusal = measured.refusal
        is_due = time.monotonic() - self._begun >= COMMIT_EVERY_S
        if not is_last and (is_due or self._chunk.is_one_by_one):
            self.commit(is_whole=False)

    def commit(self, *, is_whole: bool) -> None:
        """Store evidence, count frames, and mark a complete chunk, in one transaction.

        Frames that another process has measured meanwhile are not counted again. A
        chunk with frames that cannot be read is put into quarantine once all its other
        frames are stored.
        """
        measured, self._measured, self._begun = self._measured, [], time.monotonic()
        scope = self._chunk.scope
        if not measured and not is_whole:
            return
        with self._task.context.database.write() as session:
            run = self._task.row(session)
            new = EvidenceRepository(session).lacking(
                [frame.frame_id for frame in measured], scope.measurement_id
            )
            kept = [frame for frame in measured if frame.frame_id in new]
            EvidenceRepository(session).add([frame.row for frame in kept])
            for frame in kept:
                if frame.damage is not None:
                    note_problem(session, scope.dataset_id, frame.key, frame.damage)
            run.done = min(run.total, run.done + len(new))
            if new:
                self._task.reset_attempts(session)
            if is_whole and self._refusal is not None:
                refuse(session, self._task.job, self._task.number, self._refusal)
            elif is_whole:
                task = self._task
                ChunkRepository(session).mark_done(task.job, task.number)
