"""Frames of a folder decided on all cores, each as the line that stands for it.

Decoding lets go of Python's lock, describing decisions does not: the more threads, the
longer they wait for each other. Processes do not, but take a second to start and pass
lines on, so a few frames, or two cores, are left to threads. Lines come in the order of
the frames either way, a bounded number ahead.
"""

from __future__ import annotations

import multiprocessing
import multiprocessing.util
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import islice
from multiprocessing.connection import wait
from multiprocessing.context import BaseContext
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from unghost.cli.exits import Refused

if TYPE_CHECKING:
    from filter_core.config.filter import FilterConfig
    from filter_core.formats.reading import FrameSet, FrameSource
    from filter_core.local import FrameOutcome

FEWEST_FRAMES: Final = 1000
"""Fewer are decided before processes would have started."""
FEWEST_PROCESSES: Final = 3
"""Two threads wait for each other less than two processes cost."""
_PART: Final = 8
"""Frames that are handed to a process together."""
_PARTS_AHEAD: Final = 4
"""Per process."""


@dataclass(frozen=True)
class FrameLine:
    """A frame's line, how many of its boxes got which verdict, or what is wrong."""

    key: str
    content: bytes
    verdicts: Counter[str] = field(default_factory=Counter)
    fault: str | None = None


def decided_lines(
    found: FrameSet, config: FilterConfig, workers: int | None
) -> Generator[FrameLine, None, None]:
    """The lines of all frames; `workers` are threads or processes.

    Raises
    ------
    Refused
        A process ended while it worked on frames, which are named.
    """
    count = workers or os.cpu_count() or 1
    is_short = found.count is not None and found.count < FEWEST_FRAMES
    if count < FEWEST_PROCESSES or is_short:
        from filter_core.local import in_order

        return in_order(partial(_line_of, config), found, workers)
    return _by_processes(found, config, count)


class _Part(NamedTuple):
    keys: tuple[str, str]
    lines: Future[list[FrameLine]]


def _by_processes(
    found: FrameSet, config: FilterConfig, count: int
) -> Generator[FrameLine, None, None]:
    waiting: deque[_Part] = deque()
    pool = ProcessPoolExecutor(count, _context(), _begin)
    try:
        for frames in _parts(found):
            keys = frames[0].key, frames[-1].key
            waiting.append(_Part(keys, pool.submit(_lines_of, config, frames)))
            if len(waiting) >= count * _PARTS_AHEAD:
                yield from waiting[0].lines.result()
                waiting.popleft()
        while waiting:
            yield from waiting[0].lines.result()
            waiting.popleft()
    except BrokenProcessPool:
        first, last = waiting[0].keys[0], waiting[-1].keys[1]
        raise Refused(
            f"a process ended while it worked on frames {first!r} to {last!r}: one of "
            "them crashes a library, or memory has run out"
        ) from None
    finally:
        pool.shutdown(cancel_futures=True)


def _parts(found: Iterable[FrameSource]) -> Iterator[list[FrameSource | FrameOutcome]]:
    frames = map(_sendable, found)
    while part := list(islice(frames, _PART)):
        yield part


def _sendable(source: FrameSource) -> FrameSource | FrameOutcome:
    """A frame as another process can take it: errors cannot be sent as they are."""
    from filter_core.errors import problem_of
    from filter_core.local import FrameOutcome

    if source.problem is None:
        return source
    return FrameOutcome(source.key, error=problem_of(source.problem))


def _context() -> BaseContext:
    """Processes that start from a clean one, where the system can fork; else anew."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    # Python 3.10.0 to 3.10.8 let every user of the machine talk to the process that
    # forks (CVE-2022-42919), unless its socket is a file.
    vars(multiprocessing.util)["abstract_sockets_supported"] = False
    context = multiprocessing.get_context("forkserver")
    # Imported once, and shared by all.
    context.set_forkserver_preload(["filter_core.local", "pydantic"])
    return context


def _begin() -> None:
    """In a process that has just started."""
    import cv2

    cv2.setNumThreads(1)  # the other cores have processes of their own
    # Ctrl-C is the command's to hear: it lets the frames at hand be finished.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A command that is killed cannot tell its processes to end."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def _lines_of(
    config: FilterConfig, frames: list[FrameSource | FrameOutcome]
) -> list[FrameLine]:
    return [_line_of(config, frame) for frame in frames]


def _line_of(config: FilterConfig, frame: FrameSource | FrameOutcome) -> FrameLine:
    from filter_core.local import FrameOutcome, filter_one
    from filter_core.segmentation.reading import SegmentationOptions

    outcome = frame
    if not isinstance(outcome, FrameOutcome):
        outcome = filter_one(outcome, config, SegmentationOptions())
    content = _encoder()(outcome.as_dict()) + b"\n"
    if outcome.error is not None:
        return FrameLine(outcome.key, content, fault=outcome.error["detail"])
    verdicts = Counter(str(each["verdict"]) for each in outcome.decisions or ())
    return FrameLine(outcome.key, content, verdicts)


@cache
def _encoder() -> Callable[[dict[str, Any]], bytes]:
    """What makes the lines: a frame has some 700 values, so the encoder matters."""
    from pydantic import TypeAdapter

    return TypeAdapter(dict[str, Any]).dump_json
