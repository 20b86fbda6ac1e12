"""Runs: requests for them, their jobs and their descriptions.

Frames are measured in many small transactions (`app.runs.measure`); the final step is
one transaction (`app.runs.activate`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

from sqlalchemy.orm import Session

from app.boxes.queries import FrameRepository
from app.catalog.configs import ConfigRepository
from app.catalog.datasets import DatasetRepository
from app.context import ServiceContext
from app.db.base import filled, response_of, utc_now
from app.db.tables import Chunk, ConfigVersion, Dataset, Measurement, Run
from app.errors import NotFound
from app.jobs.queries import job_of
from app.jobs.service import queue_job
from app.measuring.active import active_config, active_version, add_version, config_of
from app.measuring.plan import (
    DatasetReading,
    active_measurement,
    in_version,
    measurement_for,
    needs_pixels,
    plan_for,
    version_of,
)
from app.measuring.queries import EvidenceRepository
from app.runs.activate import decide_all
from app.runs.measure import measure_chunk, plan_frames, unmeasured_of
from app.runs.queries import RunRepository
from filter_core.config.filter import FilterConfig
from unghost.wire import runs as wire

_MOST_NAMED: Final = 20


@dataclass(frozen=True)
class RunRequest:
    """The parameters of a new run.

    `channels` are measured in addition to those by which the configuration decides.
    `measure_again`: numbers that an earlier version has measured are not used.
    """

    config: str | FilterConfig
    author: str
    activate: bool
    reading: DatasetReading | None = None
    channels: tuple[str, ...] = ()
    measure_again: bool = False


def request_run(
    context: ServiceContext, session: Session, dataset: Dataset, request: RunRequest
) -> Run:
    """Queue a run; it starts when the transaction is committed."""
    if isinstance(request.config, FilterConfig):
        version, _ = add_version(
            session, dataset, request.config, author=request.author
        )
    else:
        named = ConfigRepository(session).find(dataset.id, request.config)
        if named is None:
            raise NotFound("config", request.config)
        version = named
    config = config_of(version)
    reading = request.reading or coming_settings(session, dataset)[0]
    plan = plan_for(reading, config).with_channels(request.channels)
    if not request.measure_again:
        stored = version_of(_coming_measurement(session, dataset))
        plan = in_version(session, dataset, plan, stored)
    measurement = measurement_for(session, dataset, reading, plan)
    run = Run(
        dataset_id=dataset.id,
        config_id=version.id,
        measurement_id=measurement.id,
        previous_run_id=dataset.active_run_id,
        kind="measure" if needs_pixels(session, dataset, plan) else "decide",
        activate=request.activate,
        total=FrameRepository(session).count(dataset.id),
        counts={},
        created_by=request.author,
    )
    queue_job(context, session, run)
    return run


def run_activating(session: Session, dataset: Dataset, digest: str) -> Run | None:
    """The last open run that activates anything, if it activates this configuration."""
    run = RunRepository(session).last_to_activate(dataset.id)
    if run is None or ConfigRepository(session).with_id(run.config_id).digest != digest:
        return None
    return run


def coming_version(session: Session, dataset: Dataset) -> ConfigVersion:
    """The configuration that is active when all open runs are done."""
    run = RunRepository(session).last_to_activate(dataset.id)
    if run is None:
        return active_version(session, dataset)
    return ConfigRepository(session).with_id(run.config_id)


def coming_settings(
    session: Session, dataset: Dataset
) -> tuple[DatasetReading, FilterConfig]:
    """The settings that are active when all open runs are done: the base of changes."""
    reading = DatasetReading.of(dataset)
    run = RunRepository(session).last_to_activate(dataset.id)
    if run is None:
        return reading, active_config(session, dataset)
    measurement = _coming_measurement(session, dataset)
    config = config_of(ConfigRepository(session).with_id(run.config_id))
    return replace(reading, **measurement.options["dataset"]), config


def is_renaming_classes(session: Session, dataset: Dataset) -> bool:
    """Whether an open run will rename classes.

    A run that is requested after it keeps its names, so the last one tells.
    """
    coming, _ = coming_settings(session, dataset)
    return coming.renamed_classes != dataset.renamed_classes


def _coming_measurement(session: Session, dataset: Dataset) -> Measurement:
    """The measurement that is active when all open runs are done."""
    run = RunRepository(session).last_to_activate(dataset.id)
    if run is None:
        return active_measurement(session, dataset)
    return EvidenceRepository(session).measurement_with_id(filled(run.measurement_id))


def describe_run(
    context: ServiceContext, run: Run, dataset: str, digest: str
) -> wire.Run:
    """A run as responses show it."""
    reported = context.engine.reported(job_of(run)) if run.state == "running" else 0
    return response_of(
        wire.Run,
        run,
        dataset=dataset,
        config=digest,
        done=max(run.done, reported),
        counts=run.counts or {},
    )


def describing_runs(
    context: ServiceContext, session: Session, runs: Sequence[Run]
) -> Callable[[Run], wire.Run]:
    """Describes each of these runs; what they share is read once."""
    digests = ConfigRepository(session).digests(run.config_id for run in runs)
    named = DatasetRepository(session).with_id
    datasets = {key: named(key).name for key in {run.dataset_id for run in runs}}

    return lambda run: describe_run(
        context, run, datasets[run.dataset_id], digests[run.config_id]
    )


def described_run(context: ServiceContext, session: Session, row: Run) -> wire.Run:
    """A run as responses show it, with its dataset's name and its digest looked up."""
    dataset = DatasetRepository(session).with_id(row.dataset_id)
    digest = ConfigRepository(session).with_id(row.config_id).digest
    return describe_run(context, row, dataset.name, digest)


class RunJobs:
    """The job kind of runs: chunks measure frames, the final step decides all boxes."""

    table = Run
    final_step_words: str | None = "deciding its boxes"
    plan = staticmethod(plan_frames)
    work = staticmethod(measure_chunk)
    finish = staticmethod(decide_all)
    unfinished = staticmethod(unmeasured_of)
    describe = staticmethod(described_run)

    def may_begin(self, session: Session, row: Run) -> bool:
        """Whether the run may begin: False if an earlier one has to activate first."""
        return not RunRepository(session).has_to_wait(row)

    def begin(self, session: Session, row: Run) -> None:
        """Count the frames, and those that an earlier run has measured already."""
        if row.state == "queued":
            row.total = FrameRepository(session).count(row.dataset_id)
        row.started_at = row.started_at or utc_now()
        missing = EvidenceRepository(session).count_unmeasured(
            row.dataset_id, filled(row.measurement_id)
        )
        # If nothing is to be measured, `done` counts the frames that are decided.
        if missing:
            row.done = max(row.done, row.total - missing)

    def name_unfinished(
        self, session: Session, row: Run, chunks: Sequence[Chunk]
    ) -> str:
        """The frames that lack their numbers, by their keys."""
        ends: set[tuple[int, int]] = set()
        for chunk in chunks:
            left = unmeasured_of(session, row, chunk)
            if chunk.error:  # these frames cannot be read; those between them can
                ends.update((frame_id, frame_id) for frame_id in left)
            elif left:
                ends.add((left[0], left[-1]))
        shown = sorted(ends)[:_MOST_NAMED]
        ids = [id_ for both in shown for id_ in both]
        frames = FrameRepository(session).with_ids(ids)
        keys = {id_: repr(frame.key) for id_, frame in frames.items()}
        named = [
            keys[first] if first == last else f"{keys[first]} to {keys[last]}"
            for first, last in shown
        ]
        if len(ends) > len(shown):
            named.append(f"{len(ends) - len(shown)} more")
        word = "frame" if len(keys) == 1 else "frames"
        return f"{word} {', '.join(named)}" if named else ""


RUNS: Final = RunJobs()
