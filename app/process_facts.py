"""What the process itself takes, under the names that Prometheus' clients share."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from app.instruments import Gauge, Samples

_STARTED_S: Final = time.time()
_SELF: Final = Path("/proc/self")
_RESIDENT_PAGES: Final = 1
"""Which number of /proc/self/statm it is."""


def process_facts() -> Iterator[Gauge]:
    """Processor time everywhere; memory and files where there is a /proc."""
    used: Samples = (({}, time.process_time()),)
    text = "Processor time of all threads."
    yield Gauge("process_cpu_seconds_total", text, used, "counter")
    yield Gauge.of("process_start_time_seconds", "Start, in Unix time.", _STARTED_S)
    if sys.platform != "linux":
        return
    pages = int((_SELF / "statm").read_text("ascii").split()[_RESIDENT_PAGES])
    size = pages * os.sysconf("SC_PAGE_SIZE")
    yield Gauge.of("process_resident_memory_bytes", "Memory in use.", size)
    files = sum(1 for _ in (_SELF / "fd").iterdir())
    yield Gauge.of("process_open_fds", "Open files and connections.", files)
