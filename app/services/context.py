"""What services share for the life of the process."""

from __future__ import annotations

from dataclasses import dataclass, field

from app.db.engine import Database
from app.engine import LocalEngine
from app.services.active import PlanCache
from app.services.numbers import NumbersCache
from app.settings import Settings
from app.storage import FolderStorage
from filter_core.config import FilterConfig


@dataclass(frozen=True)
class ServiceContext:
    """Opened once at start, closed once at the end."""

    settings: Settings
    database: Database
    storage: FolderStorage
    engine: LocalEngine
    default_config: FilterConfig = field(default_factory=FilterConfig)
    numbers: NumbersCache = field(default_factory=NumbersCache)
    plans: PlanCache = field(default_factory=PlanCache)

    def close(self) -> None:
        """Stop the work; the database is closed by who opened it."""
        self.engine.close()
