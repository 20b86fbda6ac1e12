"""How a process of the service collects garbage, and returns freed memory."""

import subprocess
import sys

import pytest

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


TRIMMED = """
import time
from pathlib import Path
from app.memory import IDLE_S, IdleTrim, keep_freed_memory

def resident_mib():
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0]) // 1024

def spike():
    pieces = [bytes(1024 * 1024 - number) for number in range(200)]
    del pieces

def work():
    until = time.process_time() + 1.1 * IDLE_S
    while time.process_time() < until:
        pass

keep_freed_memory()
trim = IdleTrim()
spike()
work()
for does in (trim.look, trim.look, spike, trim.look):
    does()
    print(resident_mib())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux for its memory")
def test_freed_memory_is_returned_once_a_process_is_idle_after_work():
    told = subprocess.run(
        [sys.executable, "-c", TRIMMED], check=True, capture_output=True, text=True
    )

    busy, idle, grown, no_work = map(int, told.stdout.split())
    assert busy - idle > 150
    assert grown - idle > 150
    assert no_work - idle > 150
