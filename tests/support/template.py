"""A program that has imported everything, and forks a process for every order.

Starting Python and importing the service takes two seconds, a fork some milliseconds.
Each fork becomes what ``python -m MODULE WORDS`` would be, with its own folder,
environment, standard streams, handlers of signals, seeds and exit code; only what /proc
says of its arguments and its environment is that of this program. The orders come from
`tests.support.processes`. Nothing here may start a thread: forks would be without it.
"""

from __future__ import annotations

import atexit
import gc
import importlib
import json
import os
import pkgutil
import runpy
import selectors
import signal
import socket
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

LONGEST_ORDER = 1 << 17
STREAMS = 3
PACKAGES = ("app", "filter_core", "unghost")
IMPORTED_LATE = (
    "anyio._backends._asyncio",
    "encodings.idna",
    "httpcore",
    "multiprocessing.forkserver",
    "uvicorn.lifespan.on",
    "uvicorn.loops.auto",
)
"""What a server or a command imports of others when it first needs it."""
FOR_CLUSTERS = "distributed"
"""The same, of nodes of a cluster only; it takes as long as all the rest."""


def import_everything() -> None:
    """Import what any process of the tests may need."""
    for package in map(importlib.import_module, PACKAGES):
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not found.name.endswith(".__main__"):
                importlib.import_module(found.name)
    for name in IMPORTED_LATE:
        importlib.import_module(name)
    share_memory()


def share_memory() -> None:
    """Let forks leave alone what is here now, so that they need no copy of it."""
    threads = len(list(Path("/proc/self/task").iterdir()))
    assert threads == 1, f"an import has started {threads - 1} threads"
    gc.collect()
    gc.freeze()


def next_fork(orders: socket.socket) -> tuple[dict[str, Any], list[int]] | None:
    """Fork for every order that comes, and tell how each fork ends.

    Returns in every fork, with its order and its standard streams, and at the end of
    all orders in the template, with nothing.
    """
    running: dict[int, tuple[int, socket.socket]] = {}
    with selectors.PollSelector() as waiting:
        waiting.register(orders, selectors.EVENT_READ)
        while True:
            for key, _ in waiting.select():
                if key.fd in running:
                    waiting.unregister(key.fd)
                    tell_the_end(key.fd, *running.pop(key.fd))
                    continue
                order, given = next_order(orders)
                if order is None:
                    kill(pid for pid, _ in running.values())
                    return None
                teller = socket.socket(fileno=given.pop())
                pid = os.fork()
                if pid == 0:
                    close(teller, orders, running)
                    return order, given
                for stream in given:
                    os.close(stream)
                teller.send(str(pid).encode())
                ends = os.pidfd_open(pid)
                running[ends] = (pid, teller)
                waiting.register(ends, selectors.EVENT_READ)


def next_order(orders: socket.socket) -> tuple[dict[str, Any] | None, list[int]]:
    """What a fork is to be, its standard streams, and where to tell its end."""
    text, given, _, _ = socket.recv_fds(orders, LONGEST_ORDER, STREAMS + 1)
    if not text:
        return None, given
    order = json.loads(text)
    is_for_clusters = (
        "UNGHOST_ENGINE" in order["environ"] or "scheduler" in order["words"]
    )
    if is_for_clusters and FOR_CLUSTERS not in sys.modules:
        importlib.import_module(FOR_CLUSTERS)
        share_memory()
    return order, given


def close(
    teller: socket.socket,
    orders: socket.socket,
    running: dict[int, tuple[int, socket.socket]],
) -> None:
    """Close in a fork what is the template's."""
    for ends, (_, others_teller) in running.items():
        os.close(ends)
        others_teller.close()
    teller.close()
    orders.close()


def tell_the_end(ends: int, pid: int, teller: socket.socket) -> None:
    """Say with which code a fork has ended to whoever asked for it."""
    os.close(ends)
    _, status = os.waitpid(pid, 0)
    with teller, suppress(BrokenPipeError):  # nobody wants to know any more
        teller.send(str(os.waitstatus_to_exitcode(status)).encode())


def kill(pids: Iterable[int]) -> None:
    """Nobody is there any more who could end them."""
    for pid in pids:
        os.kill(pid, signal.SIGKILL)


def become(order: dict[str, Any], streams: list[int]) -> None:
    """Let this fork be as if it had just been started."""
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    os.chdir(order["folder"])
    os.environ.clear()
    os.environ.update(order["environ"])
    sys.path[:] = [order["folder"], *folders_given(), *folders_of_python]
    sys.argv = ["-m", *order["words"][1:]]
    sys.orig_argv = [sys.executable, "-m", *order["words"]]
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.modules["numpy"].random.seed()


def folders_given() -> list[str]:
    """Where modules are looked for because the environment says so."""
    return [one for one in os.environ.get("PYTHONPATH", "").split(os.pathsep) if one]


def run(words: list[str]) -> None:
    """Be the program; its errors and its end are the interpreter's, as of any other."""
    try:
        runpy.run_module(words[0], run_name="__main__", alter_sys=True)
    except SystemExit as ended:
        code = 0 if ended.code is None else ended.code
        if not isinstance(code, int):
            raise
    else:
        code = 0
    ends_with.append(code)
    sys.exit(code)


def leave() -> None:
    """End at once where an exit code is known: clearing all modules takes long."""
    if ends_with:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(ends_with[0] & 0xFF)


if __name__ == "__main__":
    ends_with: list[int] = []
    folders_of_python = [one for one in sys.path[1:] if one not in folders_given()]
    # Before all imports: what they register for the end runs before this.
    atexit.register(leave)
    # Who interrupts the tests means them, and they end this program.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    import_everything()
    fork = next_fork(socket.socket(fileno=int(sys.argv[1])))
    if fork is not None:
        become(*fork)
        run(fork[0]["words"])
