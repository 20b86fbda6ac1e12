"""Configuration versions, and a cache of the active ones for measuring and deciding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

from sqlalchemy.orm import Session

from app.catalog.configs import (
    ActiveRow,
    ConfigRepository,
    active_row,
    active_row_and_key,
    read_active_snapshot,
)
from app.catalog.frames import KeyRow, key_rows
from app.db import tables
from app.db.base import filled, response_of
from app.db.engine import Database
from app.db.tables import Dataset
from app.measuring.plan import plan_of
from app.measuring.queries import EvidenceRepository
from app.settings import Settings
from filter_core.config.file import load_config
from filter_core.config.filter import FilterConfig
from filter_core.config.measure import MeasureConfig
from filter_core.errors import FilterError
from unghost.wire.runs import ConfigVersion

MAX_PLANS: Final = 256

_Plans: TypeAlias = tuple[MeasureConfig, FilterConfig]


@dataclass(frozen=True)
class ActiveDataset:
    """A dataset with its active configuration and the plan for measuring new frames."""

    name: str
    row: ActiveRow
    plan: MeasureConfig
    config: FilterConfig


class UnusableConfig(Exception):
    """The configuration file of the settings cannot be read or is invalid."""


@dataclass(frozen=True)
class DefaultConfig:
    """The first configuration of new datasets; read once, at the start."""

    config: FilterConfig

    @classmethod
    def of(cls, settings: Settings) -> DefaultConfig:
        """That of the settings, else the library's; raises UnusableConfig."""
        if settings.config is None:
            return cls(FilterConfig())
        try:
            return cls(load_config(settings.config.read_bytes()).config)
        except OSError as error:
            reason = error.strerror or "it cannot be read"
            raise UnusableConfig(f"{settings.config}: {reason}") from error
        except FilterError as error:
            raise UnusableConfig(f"{settings.config}: {error}") from error


class PlanCache:
    """A cache of parsed plans and configurations, which every upload needs.

    The dataset's name is part of the key, since errors of a plan contain it.
    """

    def __init__(self) -> None:
        self._held: dict[tuple[str, str, str], _Plans] = {}

    def active(self, session: Session, name: str) -> ActiveDataset:
        """The dataset in this session's snapshot; raises NotFound."""
        return self._dataset(session, name, active_row(session, name))

    def active_and_keys(
        self, session: Session, name: str, keys: Sequence[str]
    ) -> tuple[ActiveDataset, dict[str, KeyRow]]:
        """As `active`, together with the rows of these keys of frames."""
        if len(keys) == 1:  # one statement takes half as long as three
            row, of_key = active_row_and_key(session, name, keys[0])
            return self._dataset(session, name, row), {keys[0]: of_key}
        active = self.active(session, name)
        return active, key_rows(session, active.row.dataset_id, keys) if keys else {}

    def before_measuring(
        self, database: Database, name: str, key: str
    ) -> tuple[ActiveDataset, KeyRow]:
        """A dataset and the row of a frame's key, usually by one statement.

        A session is opened only for a plan that is not cached yet.
        """
        row, of_key = read_active_snapshot(database.engine, name, key)
        plans = self._held.get(_named(name, row))
        if plans is not None:
            return ActiveDataset(name, row, *plans), of_key
        with database.read() as session:
            active, of_keys = self.active_and_keys(session, name, [key])
            return active, of_keys[key]

    def _dataset(self, session: Session, name: str, row: ActiveRow) -> ActiveDataset:
        key = _named(name, row)
        plans = self._held.get(key)
        if plans is None:
            config = config_of(ConfigRepository(session).with_id(row.config_id))
            evidence = EvidenceRepository(session)
            measurement = evidence.measurement_with_id(row.measurement_id)
            plans = plan_of(measurement, config), config
            if len(self._held) >= MAX_PLANS:
                self._held.clear()
            self._held[key] = plans
        return ActiveDataset(name, row, *plans)


def _named(name: str, row: ActiveRow) -> tuple[str, str, str]:
    return name, row.config_digest, row.measurement_digest


def add_version(
    session: Session,
    dataset: Dataset,
    config: FilterConfig,
    *,
    author: str,
    unused_keys: Sequence[str] = (),
) -> tuple[tables.ConfigVersion, bool]:
    """The version with this content, added if there is none, and whether it is new."""
    configs = ConfigRepository(session)
    version = configs.find(dataset.id, config.digest)
    if version is not None:
        return version, False
    version = tables.ConfigVersion(
        dataset_id=dataset.id,
        digest=config.digest,
        body=config.as_dict(),
        unused_keys=list(unused_keys),
        created_by=author,
    )
    return configs.add(version), True


def active_version(session: Session, dataset: Dataset) -> tables.ConfigVersion:
    """The version by which current verdicts were decided."""
    return ConfigRepository(session).with_id(filled(dataset.active_config_id))


def active_digest(session: Session, dataset: Dataset) -> str:
    """The digest of the active version."""
    return ConfigRepository(session).digest(filled(dataset.active_config_id))


def active_config(
    session: Session, dataset: Dataset, digest: str | None = None
) -> FilterConfig:
    """The configuration by which current verdicts were decided.

    `digest` is that of `active_digest`, where the caller has it.
    """
    config = _PARSED.get(digest or active_digest(session, dataset))
    return config_of(active_version(session, dataset)) if config is None else config


_PARSED: Final[dict[str, FilterConfig]] = {}
"""Configurations by digest; cleared when there are `MAX_PLANS` of them."""


def config_of(version: tables.ConfigVersion) -> FilterConfig:
    """A version as the filter's configuration; parsed once per process."""
    config = _PARSED.get(version.digest)
    if config is None:
        config = FilterConfig.from_mapping(version.body)
        if len(_PARSED) >= MAX_PLANS:
            _PARSED.clear()
        _PARSED[version.digest] = config
    return config


def describe_version(dataset: Dataset, version: tables.ConfigVersion) -> ConfigVersion:
    """A version as responses show it."""
    return response_of(
        ConfigVersion,
        version,
        # With the keys that the version is older than.
        config=config_of(version).as_dict(),
        active=version.id == dataset.active_config_id,
    )
