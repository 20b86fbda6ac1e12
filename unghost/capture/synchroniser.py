"""All measurements of one tick, or none: frames of different moments never meet."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from unghost.capture.rig import RunningSensor
from unghost.capture.simulator import Measurement


@dataclass(frozen=True)
class Missed:
    """Why a tick is not complete: a stable word, and the sensor."""

    reason: str
    sensor: str = ""

    def __str__(self) -> str:
        return f"{self.sensor} {self.reason}" if self.sensor else self.reason


_LOOK_EVERY_S = 0.2
NO_DATA = "sent nothing in time"
FROM_LATER = "sent a later tick"


def collect(
    sensors: Sequence[RunningSensor],
    frame: int,
    wait_s: float,
    *,
    check: Callable[[], None],
) -> dict[str, Measurement] | Missed:
    """What every sensor measured at tick `frame`.

    Older measurements are thrown away: they are late ones of ticks before. A newer one
    means that this tick's was lost. The time to wait is shared by all sensors, and
    `check` is called while it passes: it may raise.
    """
    deadline = time.monotonic() + wait_s
    taken: dict[str, Measurement] = {}
    for sensor in sensors:
        found = _take(sensor, frame, deadline, check)
        if isinstance(found, Missed):
            return found
        taken[sensor.name] = found
    return taken


def _take(
    sensor: RunningSensor, frame: int, deadline: float, check: Callable[[], None]
) -> Measurement | Missed:
    while True:
        check()
        left = max(0.0, deadline - time.monotonic())
        wait = min(left, _LOOK_EVERY_S)
        try:
            found = (
                sensor.inbox.get(timeout=wait) if left else sensor.inbox.get_nowait()
            )
        except queue.Empty:
            if left > wait:
                continue
            return Missed(NO_DATA, sensor.name)
        if int(found.frame) == frame:
            return found
        if int(found.frame) > frame:
            return Missed(FROM_LATER, sensor.name)


def drain(sensors: Sequence[RunningSensor]) -> None:
    """Throw away what has arrived: images of ticks that are not recorded."""
    for sensor in sensors:
        while True:
            try:
                sensor.inbox.get_nowait()
            except queue.Empty:
                break
