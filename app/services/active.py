"""How frames of a dataset are measured and decided now."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeAlias

from sqlalchemy.orm import Session

from app.db.engine import Database
from app.repositories.active import (
    ActiveRow,
    KeyRow,
    active_row,
    active_row_and_key,
    glance,
)
from app.repositories.evidence import EvidenceRepository
from app.repositories.runs import ConfigRepository
from app.services.configs import config_of
from app.services.measuring import plan_of
from filter_core.config.filter import FilterConfig
from filter_core.config.measure import MeasureConfig

MAX_PLANS: Final = 256

_Plans: TypeAlias = tuple[MeasureConfig, FilterConfig]


@dataclass(frozen=True)
class ActiveDataset:
    """A dataset as an upload meets it: how its frames are measured, and decided."""

    name: str
    row: ActiveRow
    plan: MeasureConfig
    config: FilterConfig


class PlanCache:
    """Plans by what names them: parsed once, though every upload asks.

    The dataset is part of that: a plan says who asked for what, for its errors.
    """

    def __init__(self) -> None:
        self._held: dict[tuple[str, str, str], _Plans] = {}

    def active(self, session: Session, name: str) -> ActiveDataset:
        """The dataset as this session sees it; NotFound."""
        return self._dataset(session, name, active_row(session, name))

    def active_and_key(
        self, session: Session, name: str, key: str
    ) -> tuple[ActiveDataset, KeyRow]:
        """The same, and what it has under a frame's key."""
        row, known = active_row_and_key(session, name, key)
        return self._dataset(session, name, row), known

    def before_measuring(
        self, database: Database, name: str, key: str
    ) -> tuple[ActiveDataset, KeyRow]:
        """The same, with a session only where there is more to read."""
        row, known = glance(database.engine, name, key)
        plans = self._held.get(_named(name, row))
        if plans is not None:
            return ActiveDataset(name, row, *plans), known
        with database.read() as session:
            return self.active_and_key(session, name, key)

    def _dataset(self, session: Session, name: str, row: ActiveRow) -> ActiveDataset:
        key = _named(name, row)
        plans = self._held.get(key)
        if plans is None:
            plans = _load(session, row)
            if len(self._held) >= MAX_PLANS:
                self._held.clear()
            self._held[key] = plans
        return ActiveDataset(name, row, *plans)


def _named(name: str, row: ActiveRow) -> tuple[str, str, str]:
    return name, row.config_digest, row.measurement_digest


def _load(session: Session, row: ActiveRow) -> _Plans:
    config = config_of(ConfigRepository(session).with_id(row.config_id))
    measurement = EvidenceRepository(session).measurement_with_id(row.measurement_id)
    return plan_of(measurement, config), config
