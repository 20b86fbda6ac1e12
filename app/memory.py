"""Settings of the C library's allocator and of Python's garbage collector."""

from __future__ import annotations

import ctypes
import gc
import sys
from typing import Final

_M_TRIM_THRESHOLD: Final = -1
_M_TOP_PAD: Final = -2
_M_MMAP_THRESHOLD: Final = -3
_KEEP_BYTES: Final = 256 * 1024 * 1024
_PAD_BYTES: Final = 16 * 1024 * 1024
_COLLECT_EVERY: Final = 10_000
"""New objects between two collections. Python's default is 700; describing a frame of
ten thousand boxes creates hundreds of thousands, which were scanned over and over."""


def keep_freed_memory() -> None:
    """Let glibc reuse the memory of decoded images.

    By default each image of a few megabytes is mapped, cleared and unmapped again by
    the kernel: a quarter of the processor time of measuring a frame. Other C libraries
    have no such setting and need none.
    """
    if sys.platform != "linux":
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return
    for setting, size_bytes in (
        (_M_TRIM_THRESHOLD, _KEEP_BYTES),
        (_M_MMAP_THRESHOLD, _KEEP_BYTES),
        (_M_TOP_PAD, _PAD_BYTES),
    ):
        mallopt(setting, size_bytes)


def settle() -> None:
    """Exclude the objects that exist after the start from garbage collection.

    Modules, tables and compiled statements live as long as the process. Scanning them
    in each collection delayed one response in twenty by sixty milliseconds. Objects
    created later are collected less often.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(_COLLECT_EVERY, *gc.get_threshold()[1:])
