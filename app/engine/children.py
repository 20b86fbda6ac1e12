"""Child processes that read pictures, each with limits on time and memory.

Decoders are written in C, and their input is chosen by the person who uploads it. In a
thread of the service a decoder could be neither stopped nor limited. Here each child
has a limit on memory, and each call a timeout. A child that exceeds a limit or crashes
is killed and replaced. Bytes and options go in, numbers or a drawn picture come out.

Where the system can fork, children are forked from one process that has done the
imports (the forkserver of `multiprocessing`), so that a replacement starts in some
20 ms. Elsewhere each child is a new process. Limits on memory need a system that
enforces ``RLIMIT_AS``, such as Linux.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.util import Finalize
from pathlib import Path
from queue import Empty, LifoQueue
from types import ModuleType
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias, TypeVar, cast

import cv2

from app.logs import server_log
from app.memory import keep_freed_memory
from app.metrics import PIXEL_PROCESSES_ENDED
from filter_core.errors import FilterError
from filter_core.processes import child_context

if TYPE_CHECKING:
    from multiprocessing.context import ForkServerContext, SpawnContext

    _Context: TypeAlias = ForkServerContext | SpawnContext

_Result = TypeVar("_Result")

_POLL_S: Final = 0.05
"""Interval at which a call checks whether its caller has cancelled it."""
_END_S: Final = 1.0
"""How long to wait for the end of a process whose pipe is closed."""
_start_lock: Final = threading.Lock()
"""One for all pools: a start replaces the main module for a moment, and adds to a list
that `multiprocessing` keeps of all processes without a lock."""
_NO_PROGRAM: Final = ModuleType("__main__")
_DONE, _REFUSED, _MEMORY, _FAILED = "done", "refused", "memory", "failed"


class PixelsRefused(FilterError):
    """A picture needs more time or memory than allowed, or crashes its decoder."""

    code = "pixels_refused"


class CallCancelled(Exception):
    """The caller no longer needs the result, or the pool is closed."""


class ChildFailed(Exception):
    """A programming error in a child; its traceback is the text."""


class _ChildDied(Exception):
    """The process ended before it returned a result."""


class _TooSlow(Exception):
    """The call exceeded its timeout."""


_REASONS: Final[dict[type[Exception], str]] = {
    _TooSlow: "time",
    _ChildDied: "died",
    CallCancelled: "given_up",
}
"""Why a child is replaced, as a label of the metric."""


class Subject(NamedTuple):
    """What a pool reads and the variable with its timeout, for error messages."""

    name: str
    seconds_setting: str


class PixelPool:
    """A pool of child processes, each of which executes one call at a time.

    At most `children` are started, on first use. A call may take `seconds` of wall
    time, and a child `memory_bytes` of address space in addition to that of its
    program. The modules of `preload` are imported once for all children, where the
    system can fork. All methods are thread-safe.
    """

    def __init__(
        self,
        children: int,
        *,
        seconds: float = 30.0,
        memory_bytes: int = 2 * 1024**3,
        preload: Sequence[str] = (),
        subject: Subject | None = None,
    ) -> None:
        self.children = children
        self._subject = subject or Subject("the image", "UNGHOST_MAX_PIXEL_SECONDS")
        self._seconds, self._memory_bytes = seconds, memory_bytes
        self._context = child_context([__name__, *preload])
        # Last in, first out: the child that worked last has warm caches. None stands
        # for a child that has not been started.
        self._free: LifoQueue[_Child | None] = LifoQueue()
        for _ in range(children):
            self._free.put(None)
        self._places_of_callers = threading.BoundedSemaphore(children)
        self._is_closed = self._is_prepared = False
        # At exit, before `multiprocessing` kills its processes by a signal.
        self._at_exit = Finalize(self, _end_all, (self._free,), exitpriority=1)

    def run(
        self,
        work: Callable[..., _Result],
        *args: object,
        cancelled: threading.Event | None = None,
    ) -> _Result:
        """Call a function in the next free child, and wait for the result.

        `work` is a function at the top of a module; it, `args` and the result are
        pickled. If the caller sets `cancelled`, a running child is killed, and none is
        started.

        Raises FilterError: as `work` raised it; PixelsRefused: it took too much time or
        memory, or crashed two children; CallCancelled: `cancelled` was set first, or
        the pool was closed; ChildFailed: `work` raised any other exception.
        """
        message = pickle.dumps((work, args), pickle.HIGHEST_PROTOCOL)
        try:
            return cast("_Result", self._ask(message, cancelled))
        except _ChildDied as died:
            # The picture may not be the cause: somebody may have killed the process.
            server_log.warning("a process that reads images %s; trying another", died)
        try:
            return cast("_Result", self._ask(message, cancelled))
        except _ChildDied as died:
            raise PixelsRefused(
                f"reading {self._subject.name} crashed two processes: the last {died}"
            ) from died

    def run_here(self, work: Callable[..., _Result], *args: object) -> _Result:
        """Call a function in the caller's thread, for work that is known to be cheap.

        Its time and memory are not limited. In a child a frame takes a fifth longer,
        mostly because its data is in the processor caches of the other process. At most
        `children` threads do this at a time. Raises the errors of `work`.
        """
        with self._places_of_callers:
            return work(*args)

    def prepare(self) -> None:
        """Start a child in the background, unless this was done before.

        So the first call need not wait for the imports of all children.
        """
        if self._is_prepared:
            return
        self._is_prepared = True

        def start() -> None:
            with suppress(CallCancelled, _ChildDied, OSError):
                self._free.put(self._next_child(None))

        threading.Thread(target=start, daemon=True).start()

    def close(self) -> None:
        """End all children, without waiting for their work."""
        self._is_closed = True
        self._at_exit()
        for _ in range(self.children):
            self._free.put(None)  # wakes callers that wait for a child

    def _ask(self, message: bytes, cancelled: threading.Event | None) -> object:
        child = self._next_child(cancelled)
        reason = "stopped"
        try:
            kind, result = child.ask(message, self._seconds, cancelled)
            # A child that ran out of memory may still hold much of it: replace it.
            reason = _MEMORY if kind == _MEMORY else ""
        except tuple(_REASONS) as ended:
            reason = _REASONS[type(ended)]
            if isinstance(ended, _TooSlow):
                raise PixelsRefused(
                    f"reading {self._subject.name} takes longer than the "
                    f"{self._seconds:g} s that {self._subject.seconds_setting} allows"
                ) from None
            raise
        finally:
            if reason:  # it is killed, and replaced by the next call
                child.kill()
                PIXEL_PROCESSES_ENDED.labels(reason).inc()
            elif self._is_closed:
                child.end()
            self._free.put(None if reason or self._is_closed else child)
        if kind == _REFUSED:
            raise cast("FilterError", result)
        if kind == _MEMORY:
            mebibytes = self._memory_bytes // 1024**2
            raise PixelsRefused(
                f"reading {self._subject.name} needs more memory than the {mebibytes} "
                "MiB that UNGHOST_MAX_PIXEL_MEMORY_BYTES allows"
            )
        if kind == _FAILED:
            raise ChildFailed(str(result))
        return result

    def _next_child(self, cancelled: threading.Event | None) -> _Child:
        while True:
            if cancelled is not None and cancelled.is_set():
                raise CallCancelled
            with suppress(Empty):
                place = self._free.get(timeout=None if cancelled is None else _POLL_S)
                break
        if self._is_closed:
            self._free.put(place)
            raise CallCancelled
        if place is not None and place.is_alive():
            return place
        try:
            return _Child(self._context, self._memory_bytes)
        except BaseException:
            self._free.put(None)
            raise


def _end_all(free: LifoQueue[_Child | None]) -> None:
    with suppress(Empty):
        while True:
            child = free.get_nowait()
            if child is not None:
                child.end()


class _Child:
    """A child process and the pipe to it."""

    def __init__(self, context: _Context, memory_bytes: int) -> None:
        ours, theirs = context.Pipe()
        self._pipe: Connection = ours
        self._process = context.Process(
            target=_serve, args=(theirs, memory_bytes), name="pixels", daemon=True
        )
        with _start_lock:
            # Without it, `multiprocessing` imports no main program in the child.
            program, sys.modules["__main__"] = sys.modules["__main__"], _NO_PROGRAM
            try:
                self._process.start()
            finally:
                sys.modules["__main__"] = program
        theirs.close()
        try:
            self._pipe.recv_bytes()  # ready: the timeout does not include the start
        except (EOFError, OSError) as exc:
            self._process.join(_END_S)
            raise _ChildDied(ending_text(self._process.exitcode)) from exc

    def is_alive(self) -> bool:
        return bool(self._process.is_alive())

    def ask(
        self, message: bytes, seconds: float, cancelled: threading.Event | None
    ) -> tuple[str, object]:
        """Outcome and result; raises `_ChildDied`, `_TooSlow` or `CallCancelled`."""
        try:
            self._pipe.send_bytes(message)
            self._wait(seconds, cancelled)
            return cast("tuple[str, object]", self._pipe.recv())
        except (EOFError, OSError) as exc:
            self._process.join(_END_S)
            raise _ChildDied(ending_text(self._process.exitcode)) from exc

    def _wait(self, seconds: float, cancelled: threading.Event | None) -> None:
        until = time.monotonic() + seconds
        while not self._pipe.poll(seconds if cancelled is None else _POLL_S):
            if cancelled is not None and cancelled.is_set():
                raise CallCancelled
            if time.monotonic() >= until:
                raise _TooSlow

    def end(self) -> None:
        """Close the pipe, on which the process ends by itself, and wait for that."""
        self._pipe.close()
        self._process.join(_END_S)
        self.kill()

    def kill(self) -> None:
        self._pipe.close()
        self._process.kill()
        self._process.join()


def ending_text(exitcode: int | None) -> str:
    """How a process ended, as a predicate: ``was ended by SIGKILL``."""
    if exitcode is not None and exitcode < 0:
        with suppress(ValueError):
            return f"was ended by {signal.Signals(-exitcode).name}"
    return f"ended with exit code {exitcode}"


def _serve(pipe: Connection, memory_bytes: int) -> None:
    """The main function of a child: executes calls until the pipe is closed."""
    # Ctrl-C in a terminal reaches all processes; the service finishes open requests.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    cv2.setNumThreads(1)  # other cores have their own children
    keep_freed_memory()
    _limit_memory(memory_bytes)
    pipe.send_bytes(b"ready")
    while True:
        try:
            message = pipe.recv_bytes()
        except EOFError:
            return
        answer = _outcome(message)
        del message
        with suppress(BrokenPipeError):
            pipe.send_bytes(answer)


def _outcome(message: bytes) -> bytes:
    kind: str
    result: object
    try:
        work, args = pickle.loads(message)  # noqa: S301  # the service sent it
        kind, result = _DONE, work(*args)
        return pickle.dumps((kind, result), pickle.HIGHEST_PROTOCOL)
    except FilterError as error:
        kind, result = _REFUSED, error
    except MemoryError:
        kind, result = _MEMORY, None
    except Exception as error:
        kind, result = _FAILED, traceback.format_exc()
        if isinstance(error, cv2.error) and error.code == cv2.Error.StsNoMem:
            kind, result = _MEMORY, None
    return pickle.dumps((kind, result), pickle.HIGHEST_PROTOCOL)


def _limit_memory(more_bytes: int) -> None:
    """Limit how much this process may grow."""
    if os.name != "posix":
        return
    import resource

    try:
        pages = int(Path("/proc/self/statm").read_text("ascii").split()[0])
    except OSError:
        return  # not Linux, where the limit has no effect
    limit = pages * resource.getpagesize() + more_bytes
    with suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
