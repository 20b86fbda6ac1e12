"""When a call is tried again, and after how long."""

from __future__ import annotations

import random
from dataclasses import dataclass
from datetime import datetime, timezone
from email.utils import parsedate_to_datetime
from typing import Final

PATIENCE: Final = 2
"""Times the attempts of a single call, for one of many that are a whole together: a
server may be started anew meanwhile."""
RETRIED_STATUS: Final = frozenset({408, 429, 502, 503, 504})


@dataclass(frozen=True)
class RetryPolicy:
    """Bounded, with full jitter: who failed together does not return together."""

    attempts: int = 4
    base_s: float = 0.2
    longest_s: float = 20.0

    def delay_s(self, attempt: int, retry_after_s: float | None = None) -> float:
        """Seconds to wait after `attempt` (from 1) failed.

        What the server asked for is the least, and is capped: a client that waits for
        an hour without a word looks like one that hangs.
        """
        ceiling = min(self.longest_s, self.base_s * 2 ** (attempt - 1))
        jitter = random.uniform(0, ceiling)
        if retry_after_s is None:
            return jitter
        return min(self.longest_s, retry_after_s + jitter)


def retry_after_s(header: str | None, now: datetime | None = None) -> float | None:
    """Seconds of a `Retry-After` header: a number or an HTTP date; else None."""
    if header is None:
        return None
    if header.strip().isdigit():
        return float(header)
    try:
        when = parsedate_to_datetime(header)
    except ValueError:
        return None
    if when.tzinfo is None:
        when = when.replace(tzinfo=timezone.utc)
    return max(0.0, (when - (now or datetime.now(timezone.utc))).total_seconds())
