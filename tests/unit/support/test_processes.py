"""A process forked from the template behaves like a newly started interpreter."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time

import pytest

from tests.support import plain_http
from tests.support.processes import CAN_FORK, start, start_anew
from tests.support.servers import running_server

pytestmark = pytest.mark.skipif(not CAN_FORK, reason="the system has no pidfd_open")

PRINT_STATE = """
import gc, json, locale, os, random, signal, sys, threading
signals = (signal.SIGINT, signal.SIGPIPE, signal.SIGTERM, signal.SIGCHLD)
streams = (sys.stdin, sys.stdout, sys.stderr)
print(json.dumps({
    "name": [__name__, __spec__.name, sys.modules["__main__"].__spec__.name],
    "words": [sys.argv, sys.orig_argv[1:]],
    "folder": [os.getcwd(), sys.path[0]],
    "found in": sys.path,
    "environ": dict(os.environ),
    "signals": [str(signal.getsignal(one)) for one in signals],
    "streams": [[one.encoding, one.errors, one.isatty()] for one in streams],
    "said to it": sys.stdin.read(),
    "files": len(os.listdir("/proc/self/fd")),
    "threads": threading.active_count(),
    "locale": [locale.getlocale(), locale.getpreferredencoding()],
    "collects": [gc.isenabled(), gc.get_threshold()],
    "umask": os.umask(0),
    "flags": list(sys.flags),
}))
"""
ENDS = {
    "a code": ("raise SystemExit(3)", 3),
    "no code": ("pass", 0),
    "words": ("raise SystemExit('not today')", 1),
    "an error": ("1 / 0", 1),
    "an interrupt": ("raise KeyboardInterrupt", -signal.SIGINT),
    "a signal": ("import os; os.kill(os.getpid(), 9)", -signal.SIGKILL),
    "work at exit": ("import atexit; atexit.register(print, 'bye')", 0),
}


@pytest.fixture
def start_forked_and_fresh(tmp_path):
    """A function that starts a program twice: forked, and in a new interpreter."""

    def begin(program, *words, **more):
        (tmp_path / "program.py").write_text(program)
        environ = {**os.environ, **more}
        command = [sys.executable, "-m", "program", *words]
        return (
            start(["program", *words], tmp_path, environ),
            start_anew(command, tmp_path, environ),
        )

    return begin


def test_forked_process_has_the_same_environment_as_a_fresh_one(
    start_forked_and_fresh, tmp_path
):
    found = [
        json.loads(process.communicate(timeout=60)[0])
        for process in start_forked_and_fresh(
            PRINT_STATE, "a", "-b", UNGHOST_DATA="x", PYTHONPATH=str(tmp_path)
        )
    ]

    assert found[0] == found[1]


@pytest.mark.parametrize("end", ENDS)
def test_forked_process_exits_like_a_fresh_one(start_forked_and_fresh, end):
    program, code = ENDS[end]

    forked, fresh = [
        (*process.communicate(timeout=60), process.returncode)
        for process in start_forked_and_fresh(program)
    ]

    assert (forked[0], forked[2]) == (fresh[0], code) == (fresh[0], fresh[2])
    assert forked[1].splitlines()[-1:] == fresh[1].splitlines()[-1:]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL, signal.SIGINT])
def test_forked_process_is_terminated_by_signals(start_forked_and_fresh, number):
    for process in start_forked_and_fresh(
        "import time; print('here', flush=True); time.sleep(60)"
    ):
        with process:
            assert process.poll() is None
            assert process.stdout.readline() == "here\n"
            with pytest.raises(subprocess.TimeoutExpired):
                process.wait(0.01)
            process.send_signal(number)
            assert process.wait(60) == -number
            assert process.poll() == -number
            process.kill()  # it has ended already, which is no error


def test_forked_processes_have_different_random_seeds(start_forked_and_fresh):
    program = "import random, numpy; print(random.random(), numpy.random.random())"
    first, fresh = start_forked_and_fresh(program)
    second, other = start_forked_and_fresh(program)
    said = [one.communicate(timeout=60)[0] for one in (first, second, fresh, other)]

    assert len({number for line in said for number in line.split()}) == 8


def test_forked_server_reports_its_own_start_time(data_dir):
    began = time.time()
    with running_server(data_dir) as server:
        text = plain_http.get(f"{server.url}/metrics", headers=server.headers).text
    (started,) = re.findall(r"^process_start_time_seconds (.*)$", text, re.M)

    assert began < float(started) < time.time()
