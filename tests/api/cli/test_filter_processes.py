"""`unghost filter` on many frames, which several processes work on."""

import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from filter_core.config.filter import FilterConfig
from filter_core.formats.registry import read_source
from tests.support.command_line import CommandLine
from tests.support.frames import write_manifest
from tests.support.waiting import until
from unghost.cli.local.filter import FEWEST_PROCESSES, decided_lines

REFUSED = 1
WORKERS = FEWEST_PROCESSES
TO_ALL = ("-o", "all.jsonl")
MARK = "UNGHOST_TEST_MARK"
on_linux = pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")


@pytest.fixture
def marked(tmp_path) -> CommandLine:
    """The command line, with a mark in the environment to find its processes by."""
    return CommandLine(tmp_path, {MARK: str(tmp_path)}, anew=True)


def processes_of(folder: Path, *, working: bool = False) -> Iterator[int]:
    """Ids of the marked processes; with `working`, only of those that decide frames."""
    for entry in Path("/proc").iterdir():
        try:
            environment = (entry / "environ").read_bytes().split(b"\0")
            threads = len(list((entry / "task").iterdir()))
            name = (entry / "cmdline").read_bytes()
        except OSError:  # it is no process, or has ended meanwhile
            continue
        # Processes that decide have a second thread: it waits for the command to end.
        is_wanted = not working or (b"forkserver" in name and threads > 1)
        if is_wanted and f"{MARK}={folder}".encode() in environment:
            yield int(entry.name)


def many(folder: Path, lines: int) -> Path:
    """A folder whose manifest has this many frames, all with the same files."""
    write_manifest(folder, 1)
    manifest = folder / "manifest.jsonl"
    manifest.write_text(manifest.read_text() * lines)
    return folder


def test_processes_and_threads_give_the_same_lines(tmp_path):
    source = read_source(
        write_manifest(tmp_path / "frames", 30, bad=frozenset({3, 29}))
    )
    (tmp_path / "frames" / "seg" / "000007.png").write_bytes(b"no picture")
    (tmp_path / "frames" / "seg" / "000009.png").unlink()
    config = FilterConfig.from_mapping({"threshold_small_box": 30})
    by_threads = list(decided_lines(source, config, WORKERS))

    by_processes = list(decided_lines(source, config, WORKERS, fewest_frames=1))

    assert by_processes == by_threads
    assert [line.key for line in by_threads if line.fault] == [
        f"run/{number:06}" for number in (3, 7, 9, 29)
    ]


@pytest.mark.long
@on_linux
def test_worker_processes_exit_when_the_command_is_killed(marked, tmp_path):
    folder = many(tmp_path / "frames", 20_000)
    with marked.running("filter", folder, *TO_ALL, "--workers", WORKERS) as command:
        until(lambda: len(list(processes_of(tmp_path, working=True))) == WORKERS)

        command.kill()
        command.wait()

        until(lambda: not list(processes_of(tmp_path)))


@on_linux
def test_killed_worker_process_fails_the_command_naming_its_frames(marked, tmp_path):
    folder = many(tmp_path / "frames", 6_000)
    with marked.running("filter", folder, *TO_ALL, "--workers", WORKERS) as command:
        until(lambda: len(list(processes_of(tmp_path, working=True))) == WORKERS)

        os.kill(next(processes_of(tmp_path, working=True)), signal.SIGKILL)
        _, err = command.communicate(timeout=60)

    assert command.returncode == REFUSED
    assert "a process crashed while it worked on frames 'run/000000' to " in err
    assert "Traceback" not in err
    assert not (tmp_path / "all.jsonl").exists()
    until(lambda: not list(processes_of(tmp_path)))


def test_filtering_stops_when_its_generator_is_closed(tmp_path):
    manifest, read = read_source(many(tmp_path, 5000)), []

    def frames():
        for frame in manifest:
            read.append(frame.key)
            yield frame

    source = replace(manifest, frames=frames)
    # Other tests in this process may have left processes that decode images.
    others = set(multiprocessing.active_children())
    lines = decided_lines(source, FilterConfig(), WORKERS, fewest_frames=1)

    first = next(lines)
    started = set(multiprocessing.active_children()) - others
    lines.close()

    assert first.key == "run/000000"
    assert len(read) <= 100
    assert started
    assert started.isdisjoint(multiprocessing.active_children())
