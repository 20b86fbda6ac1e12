"""Asking for a run: which configuration, and whether pixels are needed."""

from __future__ import annotations

from dataclasses import dataclass, replace

from sqlalchemy.orm import Session

from app.boxes.queries import FrameRepository
from app.context import ServiceContext
from app.db.tables import ConfigVersion, Dataset, Run
from app.errors import NotFound
from app.jobs.service import ask
from app.measuring.active import active_version, add_version, config_of
from app.measuring.plan import DatasetReading, _measurement_for, needs_pixels, plan_for
from app.measuring.queries import ConfigRepository, EvidenceRepository
from app.repositories.runs import RunRepository
from filter_core.config.filter import FilterConfig


@dataclass(frozen=True)
class RunRequest:
    """A run as it was asked for.

    `channels` are to be measured beside those that the configuration decides by.
    """

    config: str | FilterConfig
    author: str
    activate: bool
    reading: DatasetReading | None = None
    channels: tuple[str, ...] = ()


def request_run(
    context: ServiceContext, session: Session, dataset: Dataset, wanted: RunRequest
) -> Run:
    """Queue a run; it starts when the transaction is committed."""
    version = _version(session, dataset, wanted)
    config = config_of(version)
    reading = wanted.reading or coming_settings(session, dataset)[0]
    plan = plan_for(reading, config).with_channels(wanted.channels)
    measurement = _measurement_for(session, dataset, reading, plan)
    run = Run(
        dataset_id=dataset.id,
        config_id=version.id,
        measurement_id=measurement.id,
        previous_run_id=dataset.active_run_id,
        kind="measure" if needs_pixels(session, dataset, plan) else "decide",
        activate=wanted.activate,
        total=FrameRepository(session).count(dataset.id),
        counts={},
        created_by=wanted.author,
    )
    ask(context, session, run)
    return run


def coming_settings(
    session: Session, dataset: Dataset
) -> tuple[DatasetReading, FilterConfig]:
    """What is active when all runs are done: what the next change is a change of."""
    reading = DatasetReading.of(dataset)
    run = RunRepository(session).last_to_activate(dataset.id)
    if run is None:
        return reading, config_of(active_version(session, dataset))
    measurement = EvidenceRepository(session).measurement_with_id(
        run.measurement_id or 0
    )
    config = config_of(ConfigRepository(session).with_id(run.config_id))
    return replace(reading, **measurement.options["dataset"]), config


def _version(session: Session, dataset: Dataset, wanted: RunRequest) -> ConfigVersion:
    if isinstance(wanted.config, FilterConfig):
        version, _ = add_version(session, dataset, wanted.config, author=wanted.author)
        return version
    found = ConfigRepository(session).find(dataset.id, wanted.config)
    if found is None:
        raise NotFound("config", wanted.config)
    return found
