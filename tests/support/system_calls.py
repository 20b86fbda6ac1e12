"""Runs a server under strace, and reads its system calls in order."""

import os
import re
import shutil
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.processes import children
from tests.support.servers import (
    SERVER,
    RunningServer,
    start_anew,
    token_of,
    wait_for_link,
)

TRACED = ",".join(
    [
        *("openat", "write", "pwrite64", "writev", "sendto", "sendmsg"),
        *("fsync", "fdatasync", "rename", "renameat", "renameat2"),
    ]
)
STOP_WAIT_S = 120
# A line of strace's output: 123 fsync(7</data/blobs/ab>) = 0
_CALL = re.compile(
    r"^(?P<pid>\d+) +(?P<name>\w+)\((?P<words>.*)\) += (?P<result>-?\d+)"
)
_UNFINISHED = re.compile(r"^(?P<pid>\d+) +(?P<begun>.*) <unfinished \.\.\.>$")
_RESUMED = re.compile(r"^(?P<pid>\d+) +<\.\.\. \w+ resumed>(?P<rest>.*)$")


@dataclass(frozen=True)
class Call:
    """A call that succeeded; `words` are its arguments, with paths beside numbers."""

    name: str
    words: str


def require_strace() -> str:
    """The path of strace; skips the test without it, but fails in CI."""
    strace = shutil.which("strace")
    if strace is None and os.environ.get("CI") != "true":
        pytest.skip("strace is not installed: `make test` installs it with apt")
    assert strace is not None, "continuous testing needs strace"
    return strace


@contextmanager
def traced_server(data: Path) -> Iterator[tuple[RunningServer, Path]]:
    """Start a server whose system calls strace writes to a file."""
    log, trace = data.with_name("traced.log"), data.with_name("trace")
    strace = [require_strace(), "--follow-forks", "--decode-fds=path"]
    strace += ["--seccomp-bpf", "--string-limit=48", "--signal=none"]
    strace += [f"--trace={TRACED}", f"--output={trace}"]
    process = start_anew([*strace, *SERVER], data, log, {})
    try:
        url = wait_for_link(process, log).partition("/#")[0]
        yield RunningServer(url, token_of(data), data, log, process), trace
    finally:
        # strace passes no signals on, so send the signal to the server itself.
        for child in children(process.pid):
            os.kill(child, signal.SIGTERM)
        try:
            process.wait(STOP_WAIT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        assert process.stdout is not None
        process.stdout.close()


def calls_of(trace: Path) -> list[Call]:
    """The calls that succeeded, in the order in which they returned.

    strace writes a call that overlaps with others as two lines; the second ends it.
    """
    begun: dict[str, str] = {}
    calls = []
    for line in trace.read_text("utf-8", "replace").splitlines():
        if half := _UNFINISHED.match(line):
            begun[half["pid"]] = half["begun"]
            continue
        if rest := _RESUMED.match(line):
            line = f"{rest['pid']} {begun.pop(rest['pid'], '')}{rest['rest']}"
        call = _CALL.match(line)
        if call and int(call["result"]) >= 0:
            calls.append(Call(call["name"], call["words"]))
    return calls
