"""The part of a run that makes numbers: from pixels, or from tag histograms."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, NamedTuple

from sqlalchemy.orm import Session

from app.boxes.queries import FileRow, FrameRepository
from app.context import ServiceContext
from app.db.tables import Chunk, Frame, Run
from app.engine import Job, JobStopped
from app.jobs.queries import ChunkRepository, Span
from app.measuring.active import config_of
from app.measuring.evidence import packed, recount, recounted_row
from app.measuring.pixels import MEASURED, FrameFiles, measure_files, naming
from app.measuring.plan import plan_of
from app.measuring.queries import (
    ConfigRepository,
    DatasetRepository,
    EvidenceRepository,
    EvidenceRow,
    note_problem,
)
from app.services.enduring import enduring
from app.services.run_states import job_of, run_at_work
from filter_core.annotation.parsing import parse_annotation
from filter_core.config.filter import FilterConfig
from filter_core.config.measure import MeasureConfig
from filter_core.errors import FilterError

_DAMAGED: Final = (
    *("bad_image", "image_size_mismatch", "image_too_large"),
    *("bad_instances", "lossy_instances", "bad_lidar"),
)
"""What a file is itself, whatever a configuration asks of it."""
COMMIT_EVERY_S: Final = 0.25
"""How much work a crash may cost, and how often progress is seen to move."""

Stored = Callable[[Session], None]
"""Is told of each transaction that stores numbers which were not there before."""


@dataclass(frozen=True)
class RunScope:
    """The identities of one run, read once."""

    run_id: int
    dataset_id: int
    measurement_id: int
    config: FilterConfig

    @classmethod
    def of(cls, session: Session, run: Run) -> RunScope:
        """What the run's row refers to."""
        config = config_of(ConfigRepository(session).with_id(run.config_id))
        return cls(run.id, run.dataset_id, run.measurement_id or 0, config)

    @property
    def job(self) -> Job:
        """The job that carries it out."""
        return job_of(self.run_id)


@dataclass(frozen=True)
class _Source:
    """How the frames of one chunk are measured."""

    plan: MeasureConfig
    classes: Mapping[str, int]
    measurement_id: int
    former_measurement_id: int
    needs_pixels: bool


@dataclass(frozen=True)
class _Part:
    """One chunk of a run: its frames that lack numbers, and what is known of them.

    One that ended processes is worked on frame by frame, each of which is stored before
    the next one begins: then the first that lacks its numbers is the one that kills.
    """

    scope: RunScope
    number: int
    is_suspect: bool
    missing: list[int]
    source: _Source
    frames: Mapping[int, Frame]
    files: Mapping[int, Mapping[str, FileRow]]
    former: Mapping[int, EvidenceRow]

    @classmethod
    def of(cls, session: Session, run_id: int, number: int) -> _Part:
        """What is there to do; nothing in a chunk that is done."""
        scope = RunScope.of(session, run_at_work(session, run_id))
        chunk = ChunkRepository(session).find(scope.job, number)
        missing = [] if chunk is None else _missing_of(session, scope, chunk)
        is_suspect = chunk is not None and chunk.attempts > 1
        source = _source(session, scope)
        evidence = EvidenceRepository(session)
        return cls(
            scope=scope,
            number=number,
            is_suspect=is_suspect,
            missing=missing,
            source=source,
            frames=FrameRepository(session).with_ids(missing),
            files=FrameRepository(session).files(missing),
            former=evidence.of_frames(missing, source.former_measurement_id),
        )


def plan_frames(
    session: Session, scope: RunScope, after: int, *, spans: int, frames: int
) -> list[Span]:
    """Up to so many chunks of frames behind an id that lack their numbers."""
    missing = EvidenceRepository(session).unmeasured_frames(
        scope.dataset_id, scope.measurement_id, after=after, limit=spans * frames
    )
    parts = (
        missing[start : start + frames] for start in range(0, len(missing), frames)
    )
    return [Span(part[0], part[-1], len(part)) for part in parts]


def is_measured(session: Session, scope: RunScope) -> bool:
    """True if no frame lacks its numbers: none has come in since they were made."""
    return not EvidenceRepository(session).unmeasured_frames(
        scope.dataset_id, scope.measurement_id, limit=1
    )


def frames_left(session: Session, run_id: int, chunk: Chunk) -> list[int]:
    """Frames of a chunk that lack their numbers.

    Raises
    ------
    JobStopped
        The run is over.
    """
    scope = RunScope.of(session, run_at_work(session, run_id))
    return _missing_of(session, scope, chunk)


def measure_chunk(
    context: ServiceContext, run_id: int, number: int, stored: Stored
) -> None:
    """Make the numbers of a chunk's frames that are not there yet.

    Raises
    ------
    JobStopped
        Before all were made; those that were are stored.
    """
    context.engine.check(job_of(run_id))
    with context.database.read() as session:
        part = _Part.of(session, run_id, number)
    measured, portion, over = 0, _Portion(context, part, stored), threading.Event()
    work = partial(_numbers, context, part, over)
    with ExitStack() as ending:
        results = context.engine.map(work, part.missing, one_by_one=part.is_suspect)
        rows = ending.enter_context(closing(results))
        # Threads that wait for a store are to know that nobody waits for them.
        ending.callback(over.set)
        for measured_frame in rows:
            # When the service stops, what is measured by then is kept.
            context.engine.check_wanted(part.scope.job)
            measured += 1
            portion.add(measured_frame, is_last=measured == len(part.missing))
    is_whole = measured == len(part.missing)
    portion.keep(is_whole=is_whole)
    if not is_whole:
        raise JobStopped(part.scope.job)


def _missing_of(session: Session, scope: RunScope, chunk: Chunk) -> list[int]:
    if chunk.state == "done":
        return []
    return EvidenceRepository(session).unmeasured_frames(
        scope.dataset_id,
        scope.measurement_id,
        after=chunk.first_frame_id - 1,
        until=chunk.last_frame_id,
    )


class _Measured(NamedTuple):
    """The row of a frame's numbers; which of its files is damaged, if one is."""

    row: dict[str, Any]
    key: str = ""
    damage: FilterError | None = None


def _numbers(
    context: ServiceContext, part: _Part, over: threading.Event, frame_id: int
) -> _Measured:
    source = part.source
    if source.needs_pixels:
        frame = part.frames[frame_id]
        files = part.files[frame_id]
        read = partial(_contents, context, source, files)
        check = partial(_check, context, part.scope, over)
        contents = enduring(context, check, read)
        return _remeasured(context, source, frame, contents)
    row = part.former[frame_id]
    evidence = recount(row, source.classes, source.plan)
    return _Measured(
        recounted_row(row, evidence, source.classes, source.measurement_id)
    )


class _Portion:
    """What was measured in each quarter of a second, stored together."""

    def __init__(self, context: ServiceContext, part: _Part, stored: Stored) -> None:
        self._context, self._part, self._stored = context, part, stored
        self._measured: list[_Measured] = []
        self._begun = time.monotonic()

    def add(self, measured: _Measured, *, is_last: bool) -> None:
        """One more; those of the last portion wait for `keep`."""
        self._measured.append(measured)
        is_due = time.monotonic() - self._begun >= COMMIT_EVERY_S
        if not is_last and (is_due or self._part.is_suspect):
            self.keep(is_whole=False)

    def keep(self, *, is_whole: bool) -> None:
        """Store numbers, count them, and note a chunk that is whole: one transaction.

        Frames that another process has measured meanwhile are not counted again.
        """
        measured, self._measured, self._begun = self._measured, [], time.monotonic()
        scope = self._part.scope
        if not measured and not is_whole:
            return
        with self._context.database.write() as session:
            run = run_at_work(session, scope.run_id)
            new = EvidenceRepository(session).lacking(
                [one.row["frame_id"] for one in measured], scope.measurement_id
            )
            kept = [one for one in measured if one.row["frame_id"] in new]
            EvidenceRepository(session).add([one.row for one in kept])
            for one in kept:
                if one.damage is not None:
                    note_problem(session, scope.dataset_id, one.key, one.damage)
            run.done = min(run.total, run.done + len(new))
            if new:
                self._stored(session)
            if is_whole:
                ChunkRepository(session).finish(scope.job, self._part.number)


def _source(session: Session, scope: RunScope) -> _Source:
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


def _check(context: ServiceContext, scope: RunScope, over: threading.Event) -> None:
    """JobStopped as soon as nobody wants the numbers, also if only the row says so."""
    if over.is_set():
        raise JobStopped(scope.job)
    context.engine.check(scope.job)
    with context.database.read() as session:
        run_at_work(session, scope.run_id)


def _contents(
    context: ServiceContext, source: _Source, files: Mapping[str, FileRow]
) -> dict[str, bytes]:
    return {
        kind: context.storage.read(files[kind].sha256)
        for kind in (*MEASURED, *source.plan.files)
        if kind in files
    }


def _remeasured(
    context: ServiceContext,
    source: _Source,
    frame: Frame,
    contents: Mapping[str, bytes],
) -> _Measured:
    """A frame's numbers, as if those of its files had not come that are damaged.

    They were stored by a version that looked at less of them.
    """
    annotation = parse_annotation(frame.annotation, frame=frame.key)
    size = (frame.width or 0, frame.height or 0)
    left, damage = dict(contents), None
    while True:
        try:
            with naming(frame.key, "/segmentation"):
                pixels = FrameFiles.of(left, size)
                measured = measure_files(
                    context.pixels, source.plan, annotation, pixels
                )
            break
        except FilterError as fault:
            kind = fault.pointer.strip("/")
            if fault.kind not in _DAMAGED or kind not in left:
                raise
            damage = damage or fault
            # Without its mask, pixels would count that never should.
            left = {} if kind == "ignore_mask" else _without(left, kind)
    ids = [source.classes[name] for name in measured.evidence.class_names]
    row = {
        "frame_id": frame.id,
        "measurement_id": source.measurement_id,
        **packed(measured, ids),
    }
    return _Measured(row, frame.key, damage)


def _without(contents: Mapping[str, bytes], kind: str) -> dict[str, bytes]:
    return {name: content for name, content in contents.items() if name != kind}
