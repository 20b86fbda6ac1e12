"""A program that imports everything once, and forks a process for every order.

Starting Python and importing the service takes two seconds, a fork a few milliseconds.
Each fork becomes what ``python -m MODULE WORDS`` would be, with its own folder,
environment, standard streams, signal handlers, seeds and exit code. Only /proc still
shows this program's arguments and environment. The orders come from
`tests.support.processes`. Nothing here may start a thread: forks would lack it.

The service has a process of its own from which `multiprocessing` forks those that read
images. That one is forked here as well, before the service starts threads.
"""

import atexit
import fcntl
import gc
import importlib
import json
import multiprocessing.util
import os
import pkgutil
import runpy
import selectors
import signal
import socket
import sys
import traceback
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

LONGEST_ORDER = 1 << 17
LONGEST_COMMAND = 1 << 16
STREAMS = 3
SERVICE = "app"
FORKSERVER = "multiprocessing.forkserver"
PACKAGES = ("app", "filter_core", "unghost")
IMPORTED_LATE = (
    "anyio._backends._asyncio",
    "encodings.ascii",
    "encodings.idna",
    "encodings.utf_8_sig",
    "httpcore",
    FORKSERVER,
    "numpy.ma",
    "numpy.random",
    "uvicorn.lifespan.on",
    "uvicorn.loops.auto",
)
"""Modules of other packages that a server or command imports only when needed."""
FOR_CLUSTERS = "distributed"
"""Imported for nodes of a cluster only: it takes as long as all the rest."""


def import_everything() -> None:
    """Import everything that a process of the tests may need."""
    for package in map(importlib.import_module, PACKAGES):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not module.name.endswith(".__main__"):
                importlib.import_module(module.name)
    for name in IMPORTED_LATE:
        importlib.import_module(name)
    prepare_routes()
    share_memory()


def prepare_routes() -> None:
    """Match all routes with a request, since the first one takes long."""
    request = {"type": "http", "method": "GET", "path": "/", "root_path": ""}
    for route in sys.modules["app.main"].routes():
        route.matches(request)


def share_memory() -> None:
    """Freeze all objects, so that garbage collection in forks does not copy them."""
    threads = len(list(Path("/proc/self/task").iterdir()))
    assert threads == 1, f"an import has started {threads - 1} threads"
    gc.collect()
    gc.freeze()


def next_fork(orders: socket.socket) -> tuple[dict[str, Any], list[int]] | None:
    """Fork for every order that comes, and report how each fork ends.

    In each fork, returns its order and its standard streams. In the template, returns
    None when there are no more orders.
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
                order, descriptors = next_order(orders)
                if order is None:
                    kill(pid for pid, _ in running.values())
                    return None
                teller = socket.socket(fileno=descriptors.pop())
                pid = os.fork()
                if pid == 0:
                    close(teller, orders, running)
                    return order, descriptors
                for stream in descriptors:
                    os.close(stream)
                teller.send(str(pid).encode())
                ends = os.pidfd_open(pid)
                running[ends] = (pid, teller)
                waiting.register(ends, selectors.EVENT_READ)


def next_order(orders: socket.socket) -> tuple[dict[str, Any] | None, list[int]]:
    """Read an order, and the file descriptors that come with it; None at the end."""
    text, descriptors, _, _ = socket.recv_fds(orders, LONGEST_ORDER, STREAMS + 1)
    if not text:
        return None, descriptors
    order = json.loads(text)
    is_for_clusters = (
        "UNGHOST_ENGINE" in order["environ"] or "scheduler" in order["words"]
    )
    if is_for_clusters and FOR_CLUSTERS not in sys.modules:
        importlib.import_module(FOR_CLUSTERS)
        share_memory()
    return order, descriptors


def close(
    teller: socket.socket,
    orders: socket.socket,
    running: dict[int, tuple[int, socket.socket]],
) -> None:
    """Close, in a fork, the sockets and descriptors that belong to the template."""
    for ends, (_, others_teller) in running.items():
        os.close(ends)
        others_teller.close()
    teller.close()
    orders.close()


def tell_the_end(ends: int, pid: int, teller: socket.socket) -> None:
    """Send the exit code of a fork that has ended to the process that ordered it."""
    os.close(ends)
    _, status = os.waitpid(pid, 0)
    with teller, suppress(BrokenPipeError):  # the one who ordered it has ended
        teller.send(str(os.waitstatus_to_exitcode(status)).encode())


def kill(pids: Iterable[int]) -> None:
    """Kill the forks that still run when there are no more orders."""
    for pid in pids:
        os.kill(pid, signal.SIGKILL)


def become(order: dict[str, Any], streams: list[int]) -> None:
    """Give this fork the streams, folder, environment and arguments of its order."""
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
    """The folders that PYTHONPATH names."""
    return [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]


def prepare_forkserver() -> None:
    """Fork a process that waits until `multiprocessing` wants its forkserver."""
    ours, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    pid = os.fork()
    if pid == 0:
        ours.close()
        wait_to_be_forkserver(its)
    its.close()
    prepared.append((pid, ours))


def start_program(
    path: bytes, command: Sequence[str], descriptors: Sequence[int]
) -> int:
    """Start a program for `multiprocessing`, in the prepared process if it suits."""
    if not prepared or FORKSERVER not in command[-1]:
        return start_as_given(path, command, descriptors)
    pid, teller = prepared.pop()
    wish = {
        "program": command[-1],
        "descriptors": [*descriptors],
        "environ": {**os.environ},
    }
    with teller:
        socket.send_fds(teller, [json.dumps(wish).encode()], [*descriptors])
    return pid


def wait_to_be_forkserver(wishes: socket.socket) -> None:
    """Run the program that is sent, with its descriptors; or end without one."""
    try:
        text, descriptors, _, _ = socket.recv_fds(wishes, LONGEST_COMMAND, STREAMS)
        if text:
            wish = json.loads(text)
            wishes.close()
            place(descriptors, wish["descriptors"])
            os.environ.clear()
            os.environ.update(wish["environ"])
            sys.modules["__main__"] = ModuleType("__main__")
            exec(wish["program"], vars(sys.modules["__main__"]))
    except SystemExit:
        pass  # how a forkserver ends
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)
    os._exit(0)


def place(descriptors: Sequence[int], numbers: Sequence[int]) -> None:
    """Give file descriptors the numbers that they had in another process."""
    free = max(*descriptors, *numbers) + 1
    moved = [fcntl.fcntl(descriptor, fcntl.F_DUPFD, free) for descriptor in descriptors]
    for descriptor in descriptors:
        os.close(descriptor)
    for descriptor, number in zip(moved, numbers, strict=True):
        os.dup2(descriptor, number, inheritable=False)
        os.close(descriptor)


def run(words: list[str]) -> None:
    """Run the module as the main program; exits with its code or raises its error."""
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
    """Exit at once if the code is known: clearing all modules would take long."""
    if ends_with:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(ends_with[0] & 0xFF)


if __name__ == "__main__":
    ends_with: list[int] = []
    prepared: list[tuple[int, socket.socket]] = []
    # Replaced before the service is imported, which keeps this function.
    start_as_given = multiprocessing.util.spawnv_passfds
    vars(multiprocessing.util)["spawnv_passfds"] = start_program
    folders_of_python = [path for path in sys.path[1:] if path not in folders_given()]
    # Registered before all imports, so that it runs after what they register.
    atexit.register(leave)
    # Ctrl-C is meant for the tests, which end this program when they stop.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    import_everything()
    fork = next_fork(socket.socket(fileno=int(sys.argv[1])))
    if fork is not None:
        become(*fork)
        if fork[0]["words"][0] == SERVICE:
            prepare_forkserver()
        run(fork[0]["words"])
