"""Waits for a condition, with a time limit."""

import time
from collections.abc import Callable
from typing import TypeVar

PATIENCE_S = 120
"""Longer than anything takes on a busy machine; only failing tests wait so long."""
LOOK_EVERY_S = 0.01
LONGEST_PAUSE_S = 0.1
SHARE = 0.03
"""The pause, as a share of the time waited so far, so that long waits look rarely."""


Found = TypeVar("Found")


def until(
    holds: Callable[[], Found],
    what: object = "it never holds",
    *,
    every_s: float | None = None,
) -> Found:
    """Wait until `holds()` is true, and return it; fails with `what` if it never is.

    It is called again after a pause, which grows from `LOOK_EVERY_S` with the time
    waited, or after `every_s`: soon where the state may not last.
    """
    begun = time.monotonic()
    while not (value := holds()):
        waited = time.monotonic() - begun
        assert waited < PATIENCE_S, what() if callable(what) else what
        growing = min(max(LOOK_EVERY_S, SHARE * waited), LONGEST_PAUSE_S)
        time.sleep(growing if every_s is None else every_s)
    return value
