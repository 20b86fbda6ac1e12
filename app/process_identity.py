"""What names a process for others on the same database, and whether it has ended."""

from __future__ import annotations

import os
import secrets
import socket
import sys
from pathlib import Path
from typing import Final

_PROC: Final = Path("/proc")
_START_TICK: Final = 19
"""Which word of /proc/PID/stat it is, counted behind the command's closing bracket."""


def this_process() -> str:
    """A name that no other process has, now or later, here or elsewhere."""
    pid = os.getpid()
    return f"{_machine()}/{pid}/{_started(pid)}/{secrets.token_hex(4)}"


def has_ended(name: str) -> bool:
    """True only if it surely has: a process of this machine that is not there any more.

    Of another machine, or another container, nothing can be said.
    """
    machine, _, rest = name.partition("/")
    pid, _, rest = rest.partition("/")
    if machine != _machine() or not pid.isdigit():
        return False
    if sys.platform == "linux":
        # Numbers of processes are used again; with the time of the start they are not.
        return _started(int(pid)) != rest.partition("/")[0]
    return os.name == "posix" and not _answers(int(pid))


def _machine() -> str:
    if sys.platform != "linux":
        return socket.gethostname().replace("/", "-")
    boot = (_PROC / "sys/kernel/random/boot_id").read_text("ascii").strip()
    # Containers of one machine number their processes each for itself.
    return f"{boot}-{(_PROC / 'self/ns/pid').stat().st_ino}"


def _started(pid: int) -> str:
    try:
        text = (_PROC / str(pid) / "stat").read_text("utf-8", "replace")
    except OSError:
        return ""
    words = text.rpartition(")")[2].split()
    # One that has ended and waits for its parent to notice does nothing any more.
    return "" if words[0] == "Z" else words[_START_TICK]


def _answers(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
