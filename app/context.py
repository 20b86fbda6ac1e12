"""What the whole service shares for the life of the process."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import Final, TypeVar, cast

from app.db.engine import Database
from app.engine import LocalEngine
from app.engine.children import PixelPool
from app.settings import Settings
from app.storage import BlobStore

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
    """Draws pictures: however many are asked for, frames are measured meanwhile."""
    folders: PixelPool
    """Reads dropped folders, which may take long."""
    owned: dict[type, object] = field(default_factory=dict)
    """What `one` has made, and what was kept for it."""

    def one(self, kind: type[Kind]) -> Kind:
        """The one `kind` of this process, made when it is first asked for.

        So each capability keeps what it remembers, a cache or a counter, without the
        context knowing it.
        """
        found = self.owned.get(kind)
        if found is None:
            with _MAKING:
                found = self.owned.setdefault(kind, kind())
        return cast(Kind, found)

    def keep(self, made: object) -> None:
        """Let `one` give this, which cannot be made of nothing, by its class."""
        self.owned[type(made)] = made

    def close(self) -> None:
        """Stop the work; the database is closed by who opened it."""
        self.engine.close()
        self.pixels.close()
        self.drawers.close()
        self.folders.close()
        self.storage.close()
