"""`PixelPool`: child processes that read images, with their limits and crashes."""

import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from app.engine.children import CallCancelled, ChildFailed, PixelPool, PixelsRefused
from filter_core.errors import AnnotationErrors, SegmentationError
from tests.support import pool_tasks
from tests.support.sources import CHECKOUT
from tests.support.waiting import until

PATIENCE_S = 60
LIMIT_BYTES = 256 * 1024**2


@pytest.fixture
def pool():
    pixels = PixelPool(1, seconds=PATIENCE_S, memory_bytes=LIMIT_BYTES)
    yield pixels
    pixels.close()


def is_running(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    if sys.platform != "linux":
        return True
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:  # it has ended meanwhile
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


def test_results_are_returned_and_the_child_process_is_reused(pool):
    values = np.arange(300_000)

    np.testing.assert_array_equal(pool.run(pool_tasks.doubled, values), values * 2)
    pids = {pool.run(pool_tasks.own_pid) for _ in range(5)}

    assert len(pids) == 1
    assert pids != {os.getpid()}


def test_pools_that_start_children_at_the_same_time_leave_the_main_module():
    program = sys.modules["__main__"]
    pools = [PixelPool(4) for _ in range(4)]
    calls = [pool for pool in pools for _ in range(4)]

    with ThreadPoolExecutor(len(calls)) as threads:
        list(threads.map(lambda pool: pool.run(pool_tasks.own_pid), calls))

    assert sys.modules["__main__"] is program
    for pool in pools:
        pool.close()


def test_filter_errors_of_a_child_process_keep_pointer_and_kind(pool):
    with pytest.raises(SegmentationError, match="no such tag") as refused:
        pool.run(pool_tasks.refuse)
    with pytest.raises(AnnotationErrors) as refusals:
        pool.run(pool_tasks.refuse_twice)

    assert (refused.value.pointer, refused.value.kind) == ("/segmentation", "tag")
    assert [fault.pointer for fault in refusals.value.errors] == ["/a", "/b"]


def test_internal_error_of_a_child_process_is_raised_with_its_traceback(pool):
    with pytest.raises(ChildFailed, match=r"pool_tasks.py(.|\n)*a slip of ours"):
        pool.run(pool_tasks.fail)


def test_work_beyond_the_time_limit_is_refused_and_its_process_killed(tmp_path):
    pool = PixelPool(1, seconds=1)
    note = tmp_path / "pid"

    def refused():
        """The process that was refused more time; none if it was too slow to begin."""
        with pytest.raises(PixelsRefused, match=r"than the 1 s.*MAX_PIXEL_SECONDS"):
            pool.run(pool_tasks.never_end, note)
        return int(note.read_text("utf-8") or 0) if note.exists() else 0

    def another():
        with suppress(PixelsRefused):
            return pool.run(pool_tasks.own_pid)

    killed = until(refused)

    assert not is_running(killed)
    assert until(another) != killed
    pool.close()


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux enforces the limit")
def test_work_beyond_the_memory_limit_is_refused_and_its_process_ended(pool):
    before = pool.run(pool_tasks.own_pid)

    with pytest.raises(PixelsRefused, match=r"256 MiB.*MAX_PIXEL_MEMORY_BYTES"):
        pool.run(pool_tasks.use_memory, 2 * LIMIT_BYTES)

    assert not is_running(before)
    assert pool.run(pool_tasks.use_memory, LIMIT_BYTES // 4) == 1


def test_work_that_kills_its_process_is_retried_once_and_then_refused(pool, tmp_path):
    note = tmp_path / "deaths"

    with pytest.raises(PixelsRefused, match=r"two processes.*SIGSEGV"):
        pool.run(pool_tasks.die, note)

    assert note.read_text("utf-8").split() == ["died", "died"]
    assert pool.run(pool_tasks.own_pid)


def test_work_is_retried_after_its_process_was_killed_from_outside(pool, tmp_path):
    assert pool.run(pool_tasks.die_once, tmp_path / "note") == "alive"

    idle = pool.run(pool_tasks.own_pid)
    os.kill(idle, 9)
    until(lambda: not is_running(idle))
    assert pool.run(pool_tasks.own_pid) != idle


def test_cancelling_ends_running_and_waiting_work(pool, tmp_path):
    note = tmp_path / "pid"
    first, second = threading.Event(), threading.Event()
    with ThreadPoolExecutor(2) as threads:
        working = threads.submit(pool.run, pool_tasks.never_end, note, cancelled=first)
        until(lambda: note.exists() and note.read_text("utf-8"))
        waiting = threads.submit(pool.run, pool_tasks.own_pid, cancelled=second)
        second.set()
        with pytest.raises(CallCancelled):
            waiting.result(PATIENCE_S)
        assert is_running(int(note.read_text("utf-8")))
        first.set()
        with pytest.raises(CallCancelled):
            working.result(PATIENCE_S)

    assert not is_running(int(note.read_text("utf-8")))


def test_pool_uses_all_of_its_processes_concurrently():
    pool = PixelPool(2)
    with ThreadPoolExecutor(4) as threads:
        pids = {
            each.result(PATIENCE_S)
            for each in [
                threads.submit(pool.run, pool_tasks.own_pid) for _ in range(40)
            ]
        }
    pool.close()

    assert len(pids) == 2
    until(lambda: not any(map(is_running, pids)))


PROGRAM = """
import os
from concurrent.futures import ThreadPoolExecutor
from app.engine.children import PixelPool
from tests.support import pool_tasks

pool = PixelPool(2)
with ThreadPoolExecutor(2) as threads:
    print(*threads.map(pool.run, [pool_tasks.own_pid] * 2), flush=True)
{end}
"""


@pytest.mark.parametrize(
    "end",
    [
        "os.kill(os.getpid(), 9)",
        "",
        # Python ends as it does at the end of the program.
        pytest.param("raise SystemExit(3)", marks=pytest.mark.long),
        pytest.param("pool.close()", marks=pytest.mark.long),
    ],
)
def test_child_processes_end_with_their_parent(end):
    program = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(end=end)],
        cwd=CHECKOUT,
        check=False,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )

    pids = [int(word) for word in program.stdout.split()]
    assert pids, program.stderr
    until(lambda: not any(map(is_running, pids)))
