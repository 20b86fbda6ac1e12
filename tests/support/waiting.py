"""Waits for a condition, with a time limit."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

PATIENCE_S = 120
"""Longer than anything takes on a busy machine; only failing tests wait so long."""
LOOK_EVERY_S = 0.01


Found = TypeVar("Found")


def until(
    holds: Callable[[], Found],
    what: object = "it never holds",
    *,
    every_s: float = LOOK_EVERY_S,
) -> Found:
    """Wait until `holds()` is true, and return it; fails with `what` if it never is.

    It is called again after `every_s`: soon where the state may not last.
    """
    end = time.monotonic() + PATIENCE_S
    while not (found := holds()):
        assert time.monotonic() < end, what() if callable(what) else what
        time.sleep(every_s)
    return found
