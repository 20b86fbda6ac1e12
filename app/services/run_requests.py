"""Asking for a run: which configuration, and whether pixels are needed."""

from __future__ import annotations

from dataclasses import dataclass, replace

from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.db.tables import ConfigVersion, Dataset, Measurement, Run
from app.errors import NotFound
from app.package import FILTER_CORE_VERSION
from app.repositories.evidence import EvidenceRepository
from app.repositories.frames import FrameRepository
from app.repositories.runs import ConfigRepository, RunRepository
from app.services.configs import active_version, add_version, config_of
from app.services.job_quota import require_a_place
from app.services.measuring import DatasetReading, plan_for
from filter_core.config.filter import FilterConfig
from filter_core.config.measure import MeasureConfig


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
    """Store a queued run; start it when the transaction is over (`start_runs`)."""
    require_a_place(session, context.settings, wanted.author)
    version = _version(session, dataset, wanted)
    config = config_of(version)
    reading = wanted.reading or coming_settings(session, dataset)[0]
    plan = plan_for(reading, config).with_channels(wanted.channels)
    measurement = _measurement_for(session, dataset, reading, plan)
    return RunRepository(session).add(
        Run(
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
    )


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


def needs_pixels(session: Session, dataset: Dataset, plan: MeasureConfig) -> bool:
    """Whether the numbers of this plan have to be read from images."""
    active = active_measurement(session, dataset)
    if plan.is_covered_by(active.options):
        return False
    return plan.pixel_digest != active.pixel_digest


def active_measurement(session: Session, dataset: Dataset) -> Measurement:
    """The measurement whose numbers are current."""
    if dataset.active_measurement_id is None:
        raise RuntimeError(f"dataset {dataset.name!r} has no measurement")
    return EvidenceRepository(session).measurement_with_id(
        dataset.active_measurement_id
    )


def _measurement_for(
    session: Session, dataset: Dataset, reading: DatasetReading, plan: MeasureConfig
) -> Measurement:
    """The active measurement, if it has all that is needed and perhaps more."""
    active = active_measurement(session, dataset)
    same_settings = active.options["dataset"] == reading.as_columns()
    if same_settings and plan.is_covered_by(active.options):
        return active
    return measurement_of(session, dataset.id, reading, plan)


def measurement_of(
    session: Session, dataset_id: int, reading: DatasetReading, plan: MeasureConfig
) -> Measurement:
    """The row that names a plan, made when it is first used."""
    evidence = EvidenceRepository(session)
    known = evidence.measurement(dataset_id, plan.digest)
    if known is not None:
        return known
    options = {
        **plan.as_dict(),
        "sources": dict(plan.reading.sources),
        "dataset": reading.as_columns(),
    }
    return evidence.add_measurement(
        Measurement(
            dataset_id=dataset_id,
            digest=plan.digest,
            pixel_digest=plan.pixel_digest,
            options=options,
            filter_core_version=FILTER_CORE_VERSION,
        )
    )


def _version(session: Session, dataset: Dataset, wanted: RunRequest) -> ConfigVersion:
    if isinstance(wanted.config, FilterConfig):
        version, _ = add_version(session, dataset, wanted.config, author=wanted.author)
        return version
    found = ConfigRepository(session).find(dataset.id, wanted.config)
    if found is None:
        raise NotFound("config", wanted.config)
    return found
