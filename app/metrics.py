"""How often and how fast each route answers, as Prometheus reads it."""

from __future__ import annotations

import threading
from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator
from typing import Final, NamedTuple

BUCKETS_S: Final = (0.005, 0.025, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0, 60.0)
UNKNOWN: Final = "other"
_METHODS: Final = frozenset({"GET", "POST", "PUT", "PATCH", "DELETE"})


class RouteKey(NamedTuple):
    """What is counted apart: routes by their pattern, never by what was asked for."""

    method: str
    route: str


class RequestMetrics:
    """Counts since the process started; cheap enough for every request."""

    def __init__(self, version: str) -> None:
        self._version = version
        self._lock = threading.Lock()
        self._requests: Counter[tuple[RouteKey, int]] = Counter()
        self._buckets: Counter[tuple[RouteKey, int]] = Counter()
        self._seconds: dict[RouteKey, float] = {}
        self._batch_frames: Counter[int] = Counter()

    def observe(
        self, method: str, route: str | None, status: int, seconds: float
    ) -> None:
        """Count one answer."""
        known = method if method in _METHODS else UNKNOWN
        key = RouteKey(known, route or UNKNOWN)
        with self._lock:
            self._requests[key, status] += 1
            self._buckets[key, bisect_left(BUCKETS_S, seconds)] += 1
            self._seconds[key] = self._seconds.get(key, 0.0) + seconds

    def observe_frame(self, status: int) -> None:
        """Count a frame of a batch by the status of its line."""
        with self._lock:
            self._batch_frames[status] += 1

    def text(self) -> str:
        """The counts in Prometheus' text format."""
        with self._lock:
            parts = (self._info(), self._counts(), self._durations(), self._frames())
            return "\n".join((*(line for part in parts for line in part), ""))

    def _info(self) -> Iterator[str]:
        yield "# HELP unghost_info Which version answers."
        yield "# TYPE unghost_info gauge"
        yield f'unghost_info{{version="{self._version}"}} 1'

    def _counts(self) -> Iterator[str]:
        yield "# HELP unghost_requests_total Requests answered."
        yield "# TYPE unghost_requests_total counter"
        for (key, status), count in sorted(self._requests.items()):
            labels = f'{_labels(key)},status="{status}"'
            yield f"unghost_requests_total{{{labels}}} {count}"

    def _frames(self) -> Iterator[str]:
        yield "# HELP unghost_batch_frames_total Frames of batches answered."
        yield "# TYPE unghost_batch_frames_total counter"
        for status, count in sorted(self._batch_frames.items()):
            yield f'unghost_batch_frames_total{{status="{status}"}} {count}'

    def _durations(self) -> Iterator[str]:
        yield "# HELP unghost_request_seconds Time until an answer was complete."
        yield "# TYPE unghost_request_seconds histogram"
        for key, seconds in sorted(self._seconds.items()):
            count = 0
            for index, bound in enumerate((*BUCKETS_S, "+Inf")):
                count += self._buckets[key, index]
                labels = f'{_labels(key)},le="{bound}"'
                yield f"unghost_request_seconds_bucket{{{labels}}} {count}"
            yield f"unghost_request_seconds_sum{{{_labels(key)}}} {seconds:.6f}"
            yield f"unghost_request_seconds_count{{{_labels(key)}}} {count}"


def _labels(key: RouteKey) -> str:
    return f'method="{key.method}",route="{key.route}"'
