"""Python's garbage collector runs rarely in a process of the service."""

from __future__ import annotations

import subprocess
import sys

DESCRIBED = """
import gc
from app.memory import settle
settle()
before = gc.get_stats()[0]["collections"]
boxes = [{"xyxy": [number] * 4, "hidden_by": []} for number in range(20_000)]
print(gc.get_stats()[0]["collections"] - before)
"""


def test_garbage_collector_runs_rarely_while_a_large_response_is_built():
    """The answer has sixty thousand objects, all of them still in use."""
    told = subprocess.run(
        [sys.executable, "-c", DESCRIBED], check=True, capture_output=True, text=True
    )

    assert int(told.stdout) < 10
