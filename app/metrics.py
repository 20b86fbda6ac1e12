"""What a process counts of its requests and its work, in the text of Prometheus.

Names follow Prometheus: base units, ``_total`` for what only grows. No label takes a
value that somebody outside can make up, so there are never more than so many series.
"""

from __future__ import annotations

import os
import platform
import sys
import threading
import time
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

BUCKETS_S: Final = (0.005, 0.025, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0, 60.0)
WORK_BUCKETS_S: Final = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 1.0)
UNKNOWN: Final = "other"
_METHODS: Final = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE"})
_ROUTE: Final = ("method", "route", "status")

Labels = Mapping[str, str]

_ESCAPED: Final = str.maketrans({"\\": r"\\", '"': r"\"", "\n": r"\n"})


class Counter:
    """Only grows; one number for each combination of its labels' values."""

    def __init__(self, name: str, text: str, labels: Sequence[str] = ()) -> None:
        self._name, self._text, self._labels = name, text, tuple(labels)
        self._lock = threading.Lock()
        self._counts: dict[tuple[str, ...], float] = {} if labels else {(): 0}

    def add(self, amount: float, *values: str) -> None:
        """Count more under these values of the labels, in their order."""
        with self._lock:
            self._counts[values] = self._counts.get(values, 0) + amount

    def lines(self) -> Iterator[str]:
        """In Prometheus' text format."""
        with self._lock:
            counts = sorted(self._counts.items())
        yield from described(self._name, "counter", self._text)
        for values, count in counts:
            yield sample(
                self._name, dict(zip(self._labels, values, strict=True)), count
            )


def described(name: str, kind: str, text: str) -> Iterator[str]:
    """The two lines that come before the samples of a metric."""
    yield f"# HELP {name} {text}"
    yield f"# TYPE {name} {kind}"


def sample(name: str, labels: Labels, value: float) -> str:
    """One sample; whole numbers are written as such."""
    pairs = ",".join(
        f'{key}="{val.translate(_ESCAPED)}"' for key, val in labels.items()
    )
    return f"{name}{{{pairs}}} {value:.15g}" if pairs else f"{name} {value:.15g}"


FRAMES: Final = Counter("unghost_frames_stored_total", "Frames stored, revisions too.")
BOXES: Final = Counter(
    "unghost_boxes_stored_total", "Boxes of frames that were stored."
)
FRAME_BYTES: Final = Counter(
    "unghost_frame_bytes_stored_total", "Bytes of files of frames stored.", ("kind",)
)
REFUSED: Final = Counter("unghost_frames_refused_total", "Frames with a fault.")
DECISIONS: Final = Counter(
    "unghost_decisions_total",
    "Decisions on boxes that came in.",
    ("verdict", "reason"),
)
REVIEWS: Final = Counter("unghost_reviews_total", "Answers of people.", ("verdict",))


class Histogram:
    """How observed values are spread over buckets."""

    def __init__(
        self,
        name: str,
        text: str,
        *,
        buckets: Sequence[float],
        labels: Sequence[str] = (),
    ) -> None:
        self._name, self._text, self._labels = name, text, tuple(labels)
        self._bounds = tuple(buckets)
        self._lock = threading.Lock()
        self._observed: dict[tuple[str, ...], _Observed] = {}
        if not labels:
            self._observed[()] = self._nothing()

    def observe(self, value: float, *labels: str) -> None:
        """Count one value; a bound belongs to the bucket below it."""
        with self._lock:
            observed = self._observed.get(labels)
            if observed is None:
                observed = self._observed[labels] = self._nothing()
            observed.buckets[bisect_left(self._bounds, value)] += 1
            observed.total += value

    def lines(self) -> Iterator[str]:
        """In Prometheus' text format: buckets add up from the lowest."""
        with self._lock:
            found = sorted(
                (labels, list(one.buckets), one.total)
                for labels, one in self._observed.items()
            )
        yield from described(self._name, "histogram", self._text)
        for values, buckets, total in found:
            labels = dict(zip(self._labels, values, strict=True))
            count = 0
            for bound, within in zip((*self._bounds, "+Inf"), buckets, strict=True):
                count += within
                yield sample(
                    f"{self._name}_bucket", {**labels, "le": str(bound)}, count
                )
            yield sample(f"{self._name}_sum", labels, total)
            yield sample(f"{self._name}_count", labels, count)

    def _nothing(self) -> _Observed:
        return _Observed([0] * (len(self._bounds) + 1))


@dataclass
class _Observed:
    """How many fell into each bucket, and their sum."""

    buckets: list[int]
    total: float = 0.0


DECODE_SECONDS: Final = Histogram(
    "unghost_decode_seconds",
    "Time to decode the segmentation of a frame.",
    buckets=WORK_BUCKETS_S,
)
MEASURE_SECONDS: Final = Histogram(
    "unghost_measure_seconds",
    "Time to measure the boxes of a decoded frame.",
    buckets=WORK_BUCKETS_S,
)
LOOP_STALLS: Final = Counter(
    "unghost_loop_stalls_total",
    "How often the event loop stood still for more than a second.",
)
LOOP_STALL_SECONDS: Final = Counter(
    "unghost_loop_stall_seconds_total", "How long it stood in all, once it went on."
)
PIXEL_PROCESSES_ENDED: Final = Counter(
    "unghost_pixel_processes_ended_total",
    "Processes that read pictures and were ended, by a limit or by a picture.",
    ("reason",),
)


class Instrument(Protocol):
    """Something that can say what it has counted."""

    def lines(self) -> Iterator[str]:
        """In Prometheus' text format."""


WORK: Final[tuple[Instrument, ...]] = (
    FRAMES,
    BOXES,
    FRAME_BYTES,
    REFUSED,
    DECISIONS,
    REVIEWS,
    DECODE_SECONDS,
    MEASURE_SECONDS,
    LOOP_STALLS,
    LOOP_STALL_SECONDS,
    PIXEL_PROCESSES_ENDED,
)
"""Of this process since it started; what is stored counts once it is committed."""

Samples = Iterable[tuple[Labels, float]]

_STARTED_S: Final = time.time()
_SELF: Final = Path("/proc/self")
_RESIDENT_PAGES: Final = 1
"""Which number of /proc/self/statm it is."""


@dataclass(frozen=True)
class Gauge:
    """What was found just now; a counter that somebody else keeps if `kind` says so."""

    name: str
    text: str
    samples: Samples
    kind: str = "gauge"

    @classmethod
    def of(cls, name: str, text: str, value: float) -> Gauge:
        """Without labels."""
        return cls(name, text, (({}, value),))

    def lines(self) -> Iterator[str]:
        """In Prometheus' text format."""
        yield from described(self.name, self.kind, self.text)
        for labels, value in self.samples:
            yield sample(self.name, labels, value)


class RequestMetrics:
    """What one service was asked since it started; cheap enough for every request."""

    def __init__(self, version: str) -> None:
        about = {"version": version, "python": platform.python_version()}
        self._info = Gauge("unghost_info", "Which version answers.", [(about, 1)])
        self._requests = Counter("unghost_requests_total", "Requests answered.", _ROUTE)
        self._seconds = Histogram(
            "unghost_request_seconds",
            "Time until an answer was complete.",
            buckets=BUCKETS_S,
            labels=_ROUTE,
        )
        self._batch_frames = Counter(
            "unghost_batch_frames_total", "Frames of batches answered.", ("status",)
        )

    def observe(
        self, method: str, route: str | None, status: int, seconds: float
    ) -> None:
        """Count one answer, by the pattern of its route and never by its path."""
        known = method if method in _METHODS else UNKNOWN
        key = (known, route or UNKNOWN, str(status))
        self._requests.add(1, *key)
        self._seconds.observe(seconds, *key)

    def observe_frame(self, status: int) -> None:
        """Count a frame of a batch by the status of its line."""
        self._batch_frames.add(1, str(status))

    def instruments(self) -> tuple[Instrument, ...]:
        """All of them."""
        return (self._info, self._requests, self._seconds, self._batch_frames)


def process_facts() -> Iterator[Gauge]:
    """Processor time everywhere; memory and files where there is a /proc."""
    used: Samples = (({}, time.process_time()),)
    text = "Processor time of all threads."
    yield Gauge("process_cpu_seconds_total", text, used, "counter")
    yield Gauge.of("process_start_time_seconds", "Start, in Unix time.", _STARTED_S)
    if sys.platform != "linux":
        return
    pages = int((_SELF / "statm").read_text("ascii").split()[_RESIDENT_PAGES])
    size = pages * os.sysconf("SC_PAGE_SIZE")
    yield Gauge.of("process_resident_memory_bytes", "Memory in use.", size)
    files = sum(1 for _ in (_SELF / "fd").iterdir())
    yield Gauge.of("process_open_fds", "Open files and connections.", files)
