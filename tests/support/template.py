"""A program that imports everything once, and forks a process for every order.

Starting Python and importing the service takes two seconds, a fork a few milliseconds.
Each fork becomes what ``python -m MODULE WORDS`` would be, with its own folder,
environment, standard streams, signal handlers, seeds and exit code. Only /proc still
shows this program's arguments and environment. The orders come from
`tests.support.processes`. Nothing here may start a thread: forks would lack it.

``python tests/support/template.py DESCRIPTOR`` takes orders from one program, over a
socket that it inherits. With the path of a new socket in place of the descriptor,
programs connect there, and it ends by SIGTERM. In either case the forks of a program
are killed when it ends.

The service has a process of its own from which `multiprocessing` forks those that read
images. It is forked here as well, before there are threads; what replaces it when it
has died is started as it is outside tests.
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
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

LONGEST_ORDER = 1 << 17
STREAMS = 3
SERVICE = "app"
PACKAGES = ("app", "filter_core", "unghost")
IMPORTED_LATE = (
    "anyio._backends._asyncio",
    "encodings.ascii",
    "encodings.idna",
    "encodings.utf_8_sig",
    "httpcore",
    "multiprocessing.forkserver",
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


class Order(NamedTuple):
    """What a fork is to become: its program, folder and environment; its streams."""

    words: list[str]
    folder: str
    environ: dict[str, str]
    streams: list[int]


class Fork(NamedTuple):
    """A fork that runs, where to tell its end, and where its order came from."""

    pid: int
    teller: socket.socket
    orders: socket.socket


class Template:
    """The sockets that orders come by, and the forks that run."""

    def __init__(self) -> None:
        self._waiting = selectors.PollSelector()
        self._running: dict[int, Fork] = {}

    def watch(self, wanted: socket.socket, call: Callable[[Any], Order | None]) -> None:
        """Call the function with a socket whenever something comes by it."""
        self._waiting.register(wanted, selectors.EVENT_READ, call)

    def next_fork(self) -> Order | None:
        """Fork for every order that comes, and report how each fork ends.

        In each fork, returns its order. In the template, returns None when no more
        orders can come.
        """
        while len(self._waiting.get_map()) > len(self._running):
            for key, _ in self._waiting.select():
                order: Order | None = key.data(key.fileobj)
                if order is not None:
                    return order
        return None

    def accept(self, listener: socket.socket) -> None:
        """Take orders from one more program."""
        self.watch(listener.accept()[0], self.take_order)

    def take_order(self, orders: socket.socket) -> Order | None:
        """Fork for the next order of a program; returns it in the fork.

        If the program has ended, its forks are killed.
        """
        text, streams, _, _ = socket.recv_fds(orders, LONGEST_ORDER, STREAMS + 1)
        if not text:
            self._waiting.unregister(orders)
            self.kill(orders)
            orders.close()
            return None
        order = Order(**json.loads(text), streams=streams)
        import_for_clusters(order)
        teller = socket.socket(fileno=streams.pop())
        pid = os.fork()
        if pid == 0:
            teller.close()
            self._close()
            return order
        for stream in streams:
            os.close(stream)
        teller.send(str(pid).encode())
        ends = os.pidfd_open(pid)
        self._running[ends] = Fork(pid, teller, orders)
        self._waiting.register(ends, selectors.EVENT_READ, self.tell_the_end)
        return None

    def tell_the_end(self, ends: int) -> None:
        """Send the exit code of a fork that has ended to who ordered it."""
        self._waiting.unregister(ends)
        os.close(ends)
        fork = self._running.pop(ends)
        _, status = os.waitpid(fork.pid, 0)
        with fork.teller, suppress(BrokenPipeError):  # the program has ended
            fork.teller.send(str(os.waitstatus_to_exitcode(status)).encode())

    def kill(self, orders: socket.socket | None = None) -> None:
        """Kill the forks that run, or those of one program."""
        for fork in self._running.values():
            if orders in (None, fork.orders):
                os.kill(fork.pid, signal.SIGKILL)

    def _close(self) -> None:
        """Close, in a fork, the sockets and descriptors that belong to the template."""
        for key in self._waiting.get_map().values():
            os.close(key.fd)
            if isinstance(key.fileobj, socket.socket):
                key.fileobj.detach()
        for fork in self._running.values():
            fork.teller.close()
        self._running.clear()
        self._waiting.close()


def import_for_clusters(order: Order) -> None:
    """Import what nodes of a cluster need, if the order may be one for a node."""
    if FOR_CLUSTERS in sys.modules:
        return
    if "UNGHOST_ENGINE" in order.environ or "scheduler" in order.words:
        importlib.import_module(FOR_CLUSTERS)
        share_memory()


def listen(path: str) -> socket.socket:
    """A socket by which programs of the user connect to send orders."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener.bind(path)
    listener.listen()
    return listener


def become(order: Order) -> None:
    """Give this fork the streams, folder, environment and arguments of its order."""
    for number, stream in enumerate(order.streams):
        os.dup2(stream, number)
        os.close(stream)
    os.chdir(order.folder)
    os.environ.clear()
    os.environ.update(order.environ)
    sys.path[:] = [order.folder, *folders_given(), *folders_of_python]
    sys.argv = ["-m", *order.words[1:]]
    sys.orig_argv = [sys.executable, "-m", *order.words]
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.modules["numpy"].random.seed()


def folders_given() -> list[str]:
    """The folders that PYTHONPATH names."""
    return [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]


def prepare_multiprocessing() -> None:
    """Start, while there are no threads, the processes that `multiprocessing` needs.

    These are the server from which it forks others, and its tracker of resources.
    """
    forkserver = sys.modules["multiprocessing.forkserver"]
    util = vars(sys.modules["multiprocessing.util"])
    start_as_given = util["spawnv_passfds"]
    util["spawnv_passfds"] = fork_for_multiprocessing
    forkserver.set_forkserver_preload([])  # all is imported
    forkserver.ensure_running()
    util["spawnv_passfds"] = start_as_given


def fork_for_multiprocessing(
    _path: bytes, command: Sequence[str], descriptors: Sequence[int]
) -> int:
    """Fork a process that runs a command of ``python -c``; returns its process id."""
    pid = os.fork()
    if pid != 0:
        return pid
    try:
        for entry in list(Path("/proc/self/fd").iterdir()):
            if int(entry.name) not in (*range(STREAMS), *descriptors):
                with suppress(OSError):  # that of the listing
                    os.close(int(entry.name))
        sys.modules["__main__"] = ModuleType("__main__")
        exec(command[-1], vars(sys.modules["__main__"]))
    except SystemExit:
        pass  # how the server of forks ends
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)
    os._exit(0)


def run(words: Sequence[str]) -> None:
    """Run what was ordered as the main program.

    Exits with its code or raises its error.
    """
    try:
        if words[0] == SERVICE:
            prepare_multiprocessing()
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


def main() -> None:
    """Take orders until no more come, or, in a fork, run what was ordered."""
    template, given = Template(), sys.argv[1]
    if given.isdecimal():
        template.watch(socket.socket(fileno=int(given)), template.take_order)
    elif not hasattr(os, "pidfd_open"):
        return  # the tests do not fork here
    else:
        template.watch(listen(given), template.accept)
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    try:
        import_everything()
        order = template.next_fork()
    except SystemExit:
        template.kill()
        raise
    if order is not None:
        become(order)
        run(order.words)


if __name__ == "__main__":
    ends_with: list[int] = []
    folders_of_python = [path for path in sys.path[1:] if path not in folders_given()]
    # Registered before all imports, so that it runs after what they register.
    atexit.register(leave)
    # Ctrl-C is meant for the tests, which end this program when they stop.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    main()
