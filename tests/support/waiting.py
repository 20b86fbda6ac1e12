"""Waits for a condition, with a time limit."""

from __future__ import annotations

import time
from collections.abc import Callable

PATIENCE_S = 120
"""Longer than anything takes on a busy machine; nothing waits for it that goes well."""
LOOK_EVERY_S = 0.01


def until(holds: Callable[[], object], what: object = "it never holds") -> None:
    """Wait until this is true; fails with `what` if it does not become so."""
    end = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < end, what() if callable(what) else what
        time.sleep(LOOK_EVERY_S)
