"""What a process counts: requests for each service, and the work that all have done.

Names follow Prometheus: base units, ``_total`` for what only grows. No label takes a
value that somebody outside can make up, so there are never more than so many series.
"""

from __future__ import annotations

import platform
from typing import Final

from app.instruments import Counter, Gauge, Histogram, Instrument

BUCKETS_S: Final = (0.005, 0.025, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0, 60.0)
WORK_BUCKETS_S: Final = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 1.0)
UNKNOWN: Final = "other"
_METHODS: Final = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE"})
_ROUTE: Final = ("method", "route", "status")

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
