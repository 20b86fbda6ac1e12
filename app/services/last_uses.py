"""When each token was last used, until somebody writes it down."""

from __future__ import annotations

from datetime import datetime
from threading import Lock

from app.db.base import utc_now


class LastUses:
    """Times by the number of a token; one entry each, however often it is used."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._at: dict[int, datetime] = {}

    def note(self, token_id: int) -> None:
        """It was used now."""
        with self._lock:
            self._at[token_id] = utc_now()

    def take(self) -> dict[int, datetime]:
        """What was noted since the last time."""
        with self._lock:
            taken, self._at = self._at, {}
        return taken

    def put_back(self, taken: dict[int, datetime]) -> None:
        """It could not be written; what was noted meanwhile is later."""
        with self._lock:
            self._at = {**taken, **self._at}
