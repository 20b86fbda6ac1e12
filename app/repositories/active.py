"""What is active in a dataset, read in one statement: every upload asks for it."""

from __future__ import annotations

from typing import Final, NamedTuple

from sqlalchemy import bindparam, select
from sqlalchemy.orm import Session

from app.db.tables import ConfigVersion, Dataset, Measurement
from app.errors import NotFound


class ActiveRow(NamedTuple):
    """The active configuration, run and measurement of a dataset."""

    dataset_id: int
    config_id: int
    run_id: int
    measurement_id: int
    config_digest: str
    measurement_digest: str
    classes_are_frozen: bool


# Built once: putting a statement together costs more than running it.
_ACTIVE: Final = (
    select(
        Dataset.id,
        Dataset.active_config_id,
        Dataset.active_run_id,
        Dataset.active_measurement_id,
        ConfigVersion.digest,
        Measurement.digest,
        Dataset.classes_frozen_at.is_not(None),
    )
    .join(ConfigVersion, ConfigVersion.id == Dataset.active_config_id)
    .join(Measurement, Measurement.id == Dataset.active_measurement_id)
    .where(Dataset.name == bindparam("name"))
)


def active_row(session: Session, name: str) -> ActiveRow:
    """By the dataset's name; NotFound."""
    found = session.connection().execute(_ACTIVE, {"name": name}).first()
    if found is None:
        raise NotFound("dataset", name)
    return ActiveRow._make(found)
