"""The objects that the whole service shares, from start to stop."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import Final, TypeVar, cast

from app.db.engine import Database
from app.engine.children import PixelPool
from app.engine.local import LocalEngine
from app.settings import Settings
from app.storage.base import BlobStore

Kind = TypeVar("Kind")

_MAKING: Final = threading.Lock()


@dataclass(frozen=True)
class ServiceContext:
    """Opened once at start, closed once at the end."""

    settings: Settings
    database: Database
    storage: BlobStore
    engine: LocalEngine
    pixels: PixelPool
    """Measures frames."""
    drawers: PixelPool
    """Draws pictures; a pool of its own, so that drawing never delays measuring."""
    folders: PixelPool
    """Reads dropped folders, which may take long."""
    owned: dict[type, object] = field(default_factory=dict)
    """The objects that `one` has made and `keep` has added, by class."""

    def one(self, kind: type[Kind]) -> Kind:
        """The process's only instance of `kind`, created on first use.

        It lets a feature keep a cache or a counter here without a field of its own.
        """
        instance = self.owned.get(kind)
        if instance is None:
            with _MAKING:
                instance = self.owned.setdefault(kind, kind())
        return cast(Kind, instance)

    def keep(self, made: object) -> None:
        """Let `one` return this object for its class, if that needs arguments."""
        self.owned[type(made)] = made

    def close(self) -> None:
        """Stop the workers and close the storage; the caller closes the database."""
        self.engine.close()
        self.pixels.close()
        self.drawers.close()
        self.folders.close()
        self.storage.close()
