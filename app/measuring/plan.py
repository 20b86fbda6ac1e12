"""Plans: how frames are measured, from a dataset's settings and a configuration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace

from sqlalchemy.orm import Session

from app.db.base import filled
from app.db.tables import Dataset, Measurement
from app.measuring.queries import EvidenceRepository
from app.package import FILTER_CORE_VERSION
from filter_core.config.filter import FilterConfig
from filter_core.config.measure import MeasureConfig
from filter_core.segmentation import reading
from filter_core.values import JsonObject


@dataclass(frozen=True)
class DatasetReading:
    """A dataset's settings for reading its frames.

    `renamed_classes` has the present name of a class by a name that boxes come with.
    """

    name: str
    palette: str = "auto"
    encoding: reading.Encoding = "auto"
    channel_order: reading.OrderOfChannels = "auto"
    lossy_segmentation: reading.Lossy = "refuse"
    ignore_mask: JsonObject | None = None
    renamed_classes: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, dataset: Dataset) -> DatasetReading:
        """The current settings of a dataset."""
        return cls(**{spec.name: getattr(dataset, spec.name) for spec in fields(cls)})

    def as_columns(self) -> dict[str, object]:
        """The settings without the name, as columns of the dataset's row.

        `renamed_classes` only if there are any: measurements that were stored before
        any class could be renamed have the same columns.
        """
        columns = asdict(self)
        del columns["name"]
        if not self.renamed_classes:
            del columns["renamed_classes"]
        return columns


def plan_for(dataset: DatasetReading, config: FilterConfig) -> MeasureConfig:
    """The plan for a dataset's settings and a configuration, which must agree."""
    return config.measuring(
        reading.SegmentationOptions.named_by(dataset),
        dataset_name=f"dataset {dataset.name!r}",
        renamed=dataset.renamed_classes,
        ignored=dataset.ignore_mask,
    )


def plan_of(measurement: Measurement, config: FilterConfig) -> MeasureConfig:
    """The plan by which a measurement was made."""
    return config.measuring().as_measured(measurement.options)


def version_of(measurement: Measurement) -> int:
    """The `MeasureConfig.version` in which a measurement was made."""
    return int(measurement.options.get("version", 1))


def in_version(
    session: Session, dataset: Dataset, plan: MeasureConfig, version: int
) -> MeasureConfig:
    """The plan in the version of stored numbers, if that saves reading images.

    So the numbers of an earlier version stay in use until images are read anyway.
    """
    stored = replace(plan, version=version)
    return plan if needs_pixels(session, dataset, stored) else stored


def needs_pixels(session: Session, dataset: Dataset, plan: MeasureConfig) -> bool:
    """Whether this plan needs numbers that have to be measured in images."""
    active = active_measurement(session, dataset)
    if plan.is_covered_by(active.options):
        return False
    return plan.pixel_digest != active.pixel_digest


def active_measurement(session: Session, dataset: Dataset) -> Measurement:
    """The measurement with the dataset's current numbers."""
    return EvidenceRepository(session).measurement_with_id(
        filled(dataset.active_measurement_id)
    )


def measurement_for(
    session: Session, dataset: Dataset, reading: DatasetReading, plan: MeasureConfig
) -> Measurement:
    """The active measurement if it covers the plan, else the one of the plan."""
    active = active_measurement(session, dataset)
    same_settings = active.options["dataset"] == reading.as_columns()
    if same_settings and plan.is_covered_by(active.options):
        return active
    return measurement_of(session, dataset.id, reading, plan)


def measurement_of(
    session: Session, dataset_id: int, reading: DatasetReading, plan: MeasureConfig
) -> Measurement:
    """The row of a plan, created on first use."""
    evidence = EvidenceRepository(session)
    measurement = evidence.measurement(dataset_id, plan.digest)
    if measurement is not None:
        return measurement
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
