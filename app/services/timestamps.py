"""Times as they are answered: RFC 3339, in UTC, written with a Z."""

from __future__ import annotations

from datetime import datetime, timezone


def rfc3339(at: datetime) -> str:
    """An aware time as text."""
    return at.astimezone(timezone.utc).isoformat().removesuffix("+00:00") + "Z"
