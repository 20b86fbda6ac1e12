"""Starts Python programs as separate processes, quickly.

`start` does what ``python -m MODULE WORDS`` does. Where the system supports it, it
forks the process from a template that has imported everything already
(`tests/support/template.py`): that of the whole run of tests, at the socket that
UNGHOST_TEST_TEMPLATE names, or else one of its own. The fork has its own process id,
folder, environment, streams, signals and exit code. `start_anew` starts a command
itself, for tests of the start, of memory, or of the arguments in /proc.
"""

from __future__ import annotations

import atexit
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import IO, TypeAlias

CAN_FORK = hasattr(os, "pidfd_open")
_TEMPLATE = Path(__file__).with_name("template.py")
# Read at import: the tests later run without any UNGHOST_* variables.
_SHARED = os.environ.get("UNGHOST_TEST_TEMPLATE", "")
_NUMBER = 32
# Variables that Python and libraries read when they start, which the template has
# done already. PYTHONPATH is looked at again in each fork.
_READ_AT_START = ("PYTHON", "LC_", "LANG", "LD_", "MALLOC_", "OMP_", "OPENBLAS_", "TZ")
_READ_LATER_TOO = "PYTHONPATH"


class Forked:
    """A forked process, with the methods of `subprocess.Popen` that tests use."""

    stdin = None

    def __init__(
        self,
        words: Sequence[str],
        told: socket.socket,
        out: IO[str],
        err: IO[str] | None,
    ) -> None:
        self.args = words
        self.stdout: IO[str] | None = out
        self.stderr = err
        self.returncode: int | None = None
        self._told = told
        self._asking = threading.Lock()
        self.pid = int(told.recv(_NUMBER))

    def poll(self) -> int | None:
        """The exit code; None while the process runs."""
        with suppress(subprocess.TimeoutExpired):
            self.wait(0)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end; the exit code, or minus the signal that ended it.

        Raises
        ------
        subprocess.TimeoutExpired
            It still runs after `timeout` seconds.
        """
        too_late = subprocess.TimeoutExpired(self.args, timeout or 0)
        if not self._asking.acquire(timeout=-1 if timeout is None else timeout):
            raise too_late
        try:
            if self.returncode is None:
                self._told.settimeout(timeout)
                self.returncode = int(self._told.recv(_NUMBER))
                self._told.close()
        except (TimeoutError, BlockingIOError):
            raise too_late from None
        finally:
            self._asking.release()
        return self.returncode

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """Read its standard output and errors until it ends."""
        said = ["", ""]

        def read(number: int, stream: IO[str]) -> None:
            with stream:
                said[number] = stream.read()

        readers = [
            threading.Thread(target=read, args=[number, stream], daemon=True)
            for number, stream in enumerate((self.stdout, self.stderr))
            if stream is not None
        ]
        for reader in readers:
            reader.start()
        for reader in readers:
            reader.join(timeout)
            if reader.is_alive():
                raise subprocess.TimeoutExpired(self.args, timeout or 0)
        self.wait(timeout)
        out, err = said
        return out, err

    def send_signal(self, number: int) -> None:
        """Send it a signal, unless it has ended."""
        if self.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, number)

    def terminate(self) -> None:
        """Ask it to end."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)

    def __enter__(self) -> Forked:
        return self

    def __exit__(self, *_: object) -> None:
        for stream in (self.stdout, self.stderr):
            if stream is not None:
                stream.close()
        self.wait()


Process: TypeAlias = "subprocess.Popen[str] | Forked"


def start(
    words: Sequence[str],
    folder: Path,
    environ: Mapping[str, str],
    errors: IO[str] | None = None,
) -> Process:
    """Start a process that does ``python -m MODULE WORDS`` in a folder.

    Its standard output can be read, and so can its errors unless they go to a file. Its
    standard input is empty.
    """
    if not CAN_FORK or _early(environ) != _early(os.environ):
        return start_anew([sys.executable, "-m", *words], folder, environ, errors)
    out, its_out = os.pipe()
    err, its_err = os.pipe() if errors is None else (None, os.dup(errors.fileno()))
    told, tells = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    nothing = os.open(os.devnull, os.O_RDONLY)
    order = {"words": words, "folder": str(folder), "environ": dict(environ)}
    with tells:
        theirs = [nothing, its_out, its_err]
        socket.send_fds(
            _orders(), [json.dumps(order).encode()], [*theirs, tells.fileno()]
        )
    for descriptor in theirs:
        os.close(descriptor)
    return Forked(words, told, os.fdopen(out), None if err is None else os.fdopen(err))


def start_anew(
    command: Sequence[str],
    folder: Path,
    environ: Mapping[str, str],
    errors: IO[str] | None = None,
) -> subprocess.Popen[str]:
    """Start any command as a new process, without the template."""
    return subprocess.Popen(
        command,
        cwd=folder,
        env=environ,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE if errors is None else errors,
        text=True,
    )


def children(pid: int) -> list[int]:
    """The ids of the child processes of a process."""
    ids = Path(f"/proc/{pid}/task/{pid}/children").read_text("ascii")
    return [int(child) for child in ids.split()]


def _early(environ: Mapping[str, str]) -> dict[str, str]:
    return {
        name: value
        for name, value in environ.items()
        if name.startswith(_READ_AT_START) and name != _READ_LATER_TOO
    }


@cache
def _orders() -> socket.socket:
    """The socket to a template, which kills the forks when this process ends."""
    if _SHARED:
        shared = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        shared.connect(_SHARED)
        atexit.register(shared.close)
        return shared
    ours, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    # With more, OpenBLAS would start threads, which a fork would not have.
    environ = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    with its:
        template = subprocess.Popen(
            [sys.executable, str(_TEMPLATE), str(its.fileno())],
            env=environ,
            pass_fds=[its.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
        )

    def end() -> None:
        ours.close()
        with template:
            pass

    atexit.register(end)
    return ours
