"""Functions that tests run in the processes of a `PixelPool`."""

import os
import signal
import time
from pathlib import Path

import numpy as np

from filter_core.errors import AnnotationError, AnnotationErrors, SegmentationError


def doubled(values: np.ndarray) -> np.ndarray:
    return values * 2


def own_pid() -> int:
    return os.getpid()


def refuse() -> None:
    raise SegmentationError("no such tag", pointer="/segmentation", code="tag")


def refuse_twice() -> None:
    faults = [AnnotationError(text, pointer=f"/{text}") for text in ("a", "b")]
    raise AnnotationErrors(faults)


def fail() -> None:
    raise KeyError("a slip of ours")


def use_memory(size_bytes: int) -> int:
    return int(np.ones(size_bytes, np.uint8)[-1])


def never_end(note: Path) -> None:
    note.write_text(str(os.getpid()), "utf-8")
    while True:
        time.sleep(60)


def die(note: Path) -> None:
    with note.open("a", encoding="utf-8") as stream:
        stream.write("died\n")
    os.kill(os.getpid(), signal.SIGSEGV)


def die_once(note: Path) -> str:
    if note.exists():
        return "alive"
    note.write_text("died", "utf-8")
    os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(60)
    return "never"
