"""Names of processes, by which another process can tell that one has ended.

A lease names the process that holds it (`app.jobs.leases`).
"""

from __future__ import annotations

import os
import secrets
import socket
import sys
from pathlib import Path
from typing import Final

_PROC: Final = Path("/proc")
_START_TICK: Final = 19
"""Index of the start time in /proc/PID/stat, counted after the command in brackets."""


def this_process() -> str:
    """A unique name for this process, among all processes of all machines."""
    pid = os.getpid()
    return f"{_machine()}/{pid}/{_started(pid)}/{secrets.token_hex(4)}"


def process_has_ended(name: str) -> bool:
    """Whether the process of this name ran on this machine and has ended.

    False for a process of another machine or container, which cannot be checked.
    """
    machine, _, rest = name.partition("/")
    pid, _, rest = rest.partition("/")
    if machine != _machine() or not pid.isdigit():
        return False
    if sys.platform == "linux":
        # Process ids are reused; together with the start time they are unique.
        return _started(int(pid)) != rest.partition("/")[0]
    return os.name == "posix" and not _answers(int(pid))


def _machine() -> str:
    if sys.platform != "linux":
        return socket.gethostname().replace("/", "-")
    boot = (_PROC / "sys/kernel/random/boot_id").read_text("ascii").strip()
    # Each container of a machine has its own process ids.
    return f"{boot}-{(_PROC / 'self/ns/pid').stat().st_ino}"


def _started(pid: int) -> str:
    try:
        text = (_PROC / str(pid) / "stat").read_text("utf-8", "replace")
    except OSError:
        return ""
    words = text.rpartition(")")[2].split()
    # A zombie has ended: only its parent has not read its exit status yet.
    return "" if words[0] == "Z" else words[_START_TICK]


def _answers(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
