"""Versions of configurations, and which one is active in a dataset."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from sqlalchemy import Engine, and_, bindparam, exists, select
from sqlalchemy.orm import Session

from app.catalog.datasets import is_there, no_dataset
from app.catalog.frames import KeyRow
from app.db.base import Repository, existing, insert_row
from app.db.bulk import first_row, run
from app.db.tables import ConfigVersion, Dataset, Frame, Measurement, Problem

_DIGEST: Final = select(ConfigVersion.digest).where(
    ConfigVersion.id == bindparam("config")
)


class ConfigRepository(Repository):
    """Rows of `config_versions`."""

    def find(self, dataset_id: int, digest: str) -> ConfigVersion | None:
        """A dataset's version with this digest."""
        rows = select(ConfigVersion).where(ConfigVersion.dataset_id == dataset_id)
        return self._session.scalar(rows.where(ConfigVersion.digest == digest))

    def with_id(self, config_id: int) -> ConfigVersion:
        """The version with an id from another row."""
        version = self._session.get(ConfigVersion, config_id)
        return existing(version, "config", config_id)

    def digest(self, config_id: int) -> str:
        """The digest of a version with an id from another row."""
        (digest,) = run(self._session, _DIGEST, config=config_id).scalars()
        return digest

    def with_digest(self, digest: str) -> ConfigVersion:
        """A version with this digest, of any dataset, as all of them are equal."""
        rows = (
            select(ConfigVersion)
            .join(Dataset, Dataset.id == ConfigVersion.dataset_id)
            .where(ConfigVersion.digest == digest, is_there())
        )
        version = self._session.scalar(rows.order_by(ConfigVersion.id).limit(1))
        return existing(version, "config", digest)

    def add(self, version: ConfigVersion) -> ConfigVersion:
        """Insert a version, which has its id afterwards."""
        return insert_row(self._session, version)

    def digests(self, config_ids: Iterable[int]) -> dict[int, str]:
        rows = select(ConfigVersion.id, ConfigVersion.digest).where(
            ConfigVersion.id.in_(set(config_ids))
        )
        return {row[0]: row[1] for row in self._session.execute(rows)}


class ActiveRow(NamedTuple):
    """The active configuration, run and measurement of a dataset."""

    dataset_id: int
    config_id: int
    run_id: int
    measurement_id: int
    config_digest: str
    measurement_digest: str
    classes_are_frozen: bool


_WIDTH: Final = len(ActiveRow._fields)


# Built once: building a statement takes longer than executing it.
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
    .where(Dataset.name == bindparam("name"), Dataset.removed_at.is_(None))
)


_ACTIVE_AND_KEY: Final = _ACTIVE.add_columns(
    Frame.id,
    Frame.content_digest,
    exists().where(Problem.dataset_id == Dataset.id, Problem.key == bindparam("key")),
).outerjoin(
    Frame,
    and_(
        Frame.dataset_id == Dataset.id,
        Frame.key == bindparam("key"),
        Frame.superseded_at.is_(None),
    ),
)


def active_row(session: Session, name: str) -> ActiveRow:
    """The active row of a dataset, by its name; raises NotFound."""
    row = run(session, _ACTIVE, name=name).first()
    if row is None:
        raise no_dataset(session, name)
    return ActiveRow._make(row)


def active_row_and_key(
    session: Session, name: str, key: str
) -> tuple[ActiveRow, KeyRow]:
    """The active row of a dataset and the state of a frame's key; raises NotFound."""
    row = run(session, _ACTIVE_AND_KEY, name=name, key=key).first()
    return _active_and_key(row, name)


def read_active_snapshot(
    engine: Engine, name: str, key: str
) -> tuple[ActiveRow, KeyRow]:
    """As `active_row_and_key`, without a transaction: read it again before writing."""
    return _active_and_key(first_row(engine, _ACTIVE_AND_KEY, name=name, key=key), name)


def _active_and_key(
    row: Sequence[object] | None, name: str
) -> tuple[ActiveRow, KeyRow]:
    row = existing(row, "dataset", name)
    return ActiveRow._make(row[:_WIDTH]), KeyRow._make(row[_WIDTH:])
