"""Memory: settings of the C library's allocator and of Python's garbage collector.

`forget_tracebacks` frees what errors that were handled refer to.
"""

from __future__ import annotations

import ctypes
import gc
import sys
import time
from collections.abc import Callable
from typing import Final

_KEEP_BYTES: Final = 256 * 1024 * 1024
_COLLECT_EVERY: Final = 10_000
"""New objects between two collections. Python's default is 700; describing a frame of
ten thousand boxes creates hundreds of thousands, which were scanned over and over."""
LOOK_EVERY_S: Final = 5.0
"""Seconds between two looks at whether the process is idle."""
IDLE_S: Final = 0.5
"""Processor time of all threads between two looks up to which it is idle."""


def keep_freed_memory() -> None:
    """Let glibc reuse the memory of decoded images.

    By default each image of a few megabytes is mapped, cleared and unmapped again by
    the kernel: a quarter of the processor time of measuring a frame. Other C libraries
    have no such setting and need none.
    """
    mallopt = _allocator("mallopt")
    if mallopt is None:
        return
    for setting, size_bytes in (
        (-1, _KEEP_BYTES),  # M_TRIM_THRESHOLD
        (-3, _KEEP_BYTES),  # M_MMAP_THRESHOLD
        (-2, 16 * 1024 * 1024),  # M_TOP_PAD
    ):
        mallopt(setting, size_bytes)


class IdleTrim:
    """Returns freed memory to the system when the process is idle after work.

    Otherwise it would keep all that `keep_freed_memory` lets it keep, in each arena of
    the allocator, until it ends.
    """

    def __init__(self) -> None:
        self._looked_s = self._trimmed_s = time.process_time()

    def look(self) -> None:
        """Trim if the process is idle, and has worked since it was trimmed last."""
        now_s = time.process_time()
        is_idle = now_s - self._looked_s <= IDLE_S
        self._looked_s = now_s
        if is_idle and now_s - self._trimmed_s > IDLE_S:
            self._trimmed_s = now_s
            trim = _allocator("malloc_trim")
            if trim is not None:
                trim(0)


def _allocator(name: str) -> Callable[..., int] | None:
    """A function of glibc's allocator; None with other C libraries."""
    if sys.platform != "linux":
        return None
    function: Callable[..., int] | None = getattr(ctypes.CDLL(None), name, None)
    return function


def settle() -> None:
    """Exclude the objects that exist after the start from garbage collection.

    Modules, tables and compiled statements live as long as the process. Scanning them
    in each collection delayed one response in twenty by sixty milliseconds. Objects
    created later are collected less often.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(_COLLECT_EVERY, *gc.get_threshold()[1:])


def forget_tracebacks(error: BaseException) -> None:
    """Drop the tracebacks of an error that has been handled, and of its causes.

    The frames of a traceback refer to the request's data and often to the error itself.
    Such a reference cycle stays in memory until the next full garbage collection.
    """
    left: list[BaseException | None] = [error]
    while left:
        cause = left.pop()
        if cause is not None and cause.__traceback__ is not None:
            cause.__traceback__ = None
            left += [cause.__cause__, cause.__context__]
