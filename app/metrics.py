"""Metrics of this process for Prometheus: its requests and its work.

Names follow Prometheus: base units, ``_total`` for what only grows. No label takes a
value that a client can choose, so the number of series is bounded.
Counters and histograms are those of `prometheus_client`; the figures about the process
are our own, because that library's exist on Linux only.
"""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Final

from prometheus_client import disable_created_metrics, generate_latest
from prometheus_client.core import (
    CollectorRegistry,
    Counter,
    CounterMetricFamily,
    Gauge,
    GaugeMetricFamily,
    Histogram,
    Info,
    Metric,
)
from prometheus_client.registry import Collector

BUCKETS_S: Final = (0.005, 0.025, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0, 60.0)
WORK_BUCKETS_S: Final = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 1.0)
UNKNOWN: Final = "other"
_METHODS: Final = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE"})
_ROUTE: Final = ("method", "route", "status")

# Otherwise each counter has a second series: the time at which it was created.
disable_created_metrics()

WORK: Final = CollectorRegistry()
"""Work of this process since its start; what is stored counts once committed."""

_counter: Final = partial(Counter, registry=WORK)
_histogram: Final = partial(Histogram, buckets=WORK_BUCKETS_S, registry=WORK)
FRAMES: Final = _counter(
    "unghost_frames_stored_total", "Frames stored, new revisions included."
)
BOXES: Final = _counter("unghost_boxes_stored_total", "Boxes of stored frames.")
FRAME_BYTES: Final = _counter(
    "unghost_frame_bytes_stored_total",
    "Bytes of the files of stored frames.",
    ("kind",),
)
REFUSED: Final = _counter(
    "unghost_frames_refused_total", "Frames refused because of an error in them."
)
DECISIONS: Final = _counter(
    "unghost_decisions_total", "Decisions on uploaded boxes.", ("verdict", "reason")
)
REVIEWS: Final = _counter(
    "unghost_reviews_total", "People's answers; undo: answers undone.", ("verdict",)
)
DECODE_SECONDS: Final = _histogram(
    "unghost_decode_seconds", "Time to decode the segmentation of a frame."
)
MEASURE_SECONDS: Final = _histogram(
    "unghost_measure_seconds", "Time to measure the boxes of a decoded frame."
)
LOOP_STALLS: Final = _counter(
    "unghost_loop_stalls_total",
    "How often the event loop was blocked for more than a second.",
)
LOOP_STALL_SECONDS: Final = _counter(
    "unghost_loop_stall_seconds_total",
    "Total seconds for which the event loop was blocked, in stalls that have ended.",
)
PIXEL_PROCESSES_ENDED: Final = _counter(
    "unghost_pixel_processes_ended_total",
    "Ended processes that read images, by the reason for the end.",
    ("reason",),
)

_SELF: Final = Path("/proc/self")
_RESIDENT_PAGES: Final = 1
"""Index of the resident pages in /proc/self/statm."""


class RequestMetrics:
    """Counts and durations of the requests to one service since its start."""

    def __init__(self, version: str) -> None:
        self.registry = CollectorRegistry()
        counter = partial(Counter, registry=self.registry)
        info = Info(
            "unghost", "Versions of the service and of Python.", registry=self.registry
        )
        info.info({"version": version, "python": platform.python_version()})
        self._requests = counter(
            "unghost_requests_total", "Responses to requests.", _ROUTE
        )
        self._seconds = Histogram(
            "unghost_request_seconds",
            "Time until the response was complete.",
            _ROUTE,
            buckets=BUCKETS_S,
            registry=self.registry,
        )
        started = Gauge(
            "process_start_time_seconds",
            "Start of the process, in Unix time.",
            registry=self.registry,
        )
        started.set_to_current_time()
        self._batch_frames = counter(
            "unghost_batch_frames_total",
            "Frames sent in batches, by the status of their line.",
            ("status",),
        )

    def observe(
        self, method: str, route: str | None, status: int, seconds: float
    ) -> None:
        """Count one response, by the pattern of its route and never by its path."""
        known_method = method if method in _METHODS else UNKNOWN
        key = (known_method, route or UNKNOWN, str(status))
        self._requests.labels(*key).inc()
        self._seconds.labels(*key).observe(seconds)

    def observe_frame(self, status: int) -> None:
        """Count a frame of a batch by the status of its line."""
        self._batch_frames.labels(str(status)).inc()


def process_facts() -> Iterator[Metric]:
    """Processor time everywhere; memory and files where there is a /proc."""
    text, used = "Processor time of all threads.", time.process_time()
    yield CounterMetricFamily("process_cpu_seconds_total", text, used)
    if sys.platform != "linux":
        return
    pages = int((_SELF / "statm").read_text("ascii").split()[_RESIDENT_PAGES])
    size = pages * os.sysconf("SC_PAGE_SIZE")
    yield GaugeMetricFamily(
        "process_resident_memory_bytes", "Resident memory of the process.", size
    )
    files = sum(1 for _ in (_SELF / "fd").iterdir())
    yield GaugeMetricFamily("process_open_fds", "Open files and connections.", files)


def prometheus_text(metrics: Iterable[Metric]) -> bytes:
    """Metrics in Prometheus' text format, version 0.0.4."""

    class Scrape(Collector):
        def collect(self) -> Iterable[Metric]:
            return metrics

    return generate_latest(Scrape())
