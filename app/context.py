"""What the whole service shares for the life of the process."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, TypeVar, cast

from app.db.engine import Database
from app.engine import LocalEngine
from app.engine.pixels import PixelPool
from app.incoming import OpenBodies
from app.settings import Settings
from app.storage import BlobStore
from app.storage.room import Reserve
from filter_core.config.filter import FilterConfig

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
    default_config: FilterConfig = field(default_factory=FilterConfig)
    something_to_remove: threading.Event = field(default_factory=threading.Event)
    owned: dict[type, object] = field(default_factory=dict)
    """What `one` has made."""

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

    @cached_property
    def reserve(self) -> Reserve:
        """Room that is given up when somebody deletes on a full disk."""
        return Reserve(self.settings.data)

    @cached_property
    def bodies(self) -> OpenBodies:
        """Bytes of requests that are in memory."""
        settings = self.settings
        return OpenBodies(
            int(settings.max_open_body_bytes),
            int(settings.max_open_body_bytes_per_token),
        )

    def close(self) -> None:
        """Stop the work; the database is closed by who opened it."""
        self.engine.close()
        self.pixels.close()
        self.drawers.close()
        self.storage.close()
