"""Poses as numbers, and which of a sensor's two poses is right."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Final

from filter_core.geometry.pose import Transform
from unghost.capture.simulator import Actor, Measurement, Pose, Snapshot

_DIGITS: Final = 6
_MAX_SHIFT_M: Final = 0.01
_MAX_TURN_DEG: Final = 0.1
_WRONG_METADATA: Final = ((0, 9, 14), (0, 9, 15))
"""Their images can carry the pose of another tick than the one they show."""


@dataclass(frozen=True)
class SensorPose:
    """Where a sensor stood, as its measurement says and as the snapshot says.

    Attributes
    ----------
    measured, snapshot : Transform
        `snapshot` is what the actor says where the snapshot does not have it.
    used : Transform
        The one to project with.
    """

    measured: Transform
    snapshot: Transform
    used: Transform

    @property
    def differs(self) -> bool:
        """Whether they are further apart than rounding explains."""
        return differs(self.measured, self.snapshot)


def version_numbers(version: str) -> tuple[int, ...]:
    """``0.9.15-12-gabc`` as ``(0, 9, 15)``."""
    found = re.match(r"\D*(\d+(?:\.\d+)*)", version)
    return tuple(int(part) for part in found[1].split(".")) if found else ()


def has_wrong_metadata(version: str) -> bool:
    """Whether images of this simulator may carry the pose of another tick."""
    return version_numbers(version)[:3] in _WRONG_METADATA


def as_transform(pose: Pose) -> Transform:
    """A `carla.Transform` as numbers."""
    location, rotation = pose.location, pose.rotation
    return Transform(
        (rounded(location.x), rounded(location.y), rounded(location.z)),
        (rounded(rotation.pitch), rounded(rotation.yaw), rounded(rotation.roll)),
    )


def rounded(value: float) -> float:
    """A float32 of the library, without digits that mean nothing."""
    return round(float(value), _DIGITS)


def sensor_pose(
    measurement: Measurement, sensor: Actor, snapshot: Snapshot, version: str
) -> SensorPose:
    """The poses of a sensor at one tick; which one is used depends on the version."""
    measured = as_transform(measurement.transform)
    found = snapshot.find(sensor.id)
    there = as_transform((sensor if found is None else found).get_transform())
    used = there if has_wrong_metadata(version) else measured
    return SensorPose(measured, there, used)


def differs(one: Transform, other: Transform) -> bool:
    """Further apart than a centimetre, or turned by more than a tenth of a degree."""
    if math.dist(one.location, other.location) > _MAX_SHIFT_M:
        return True
    turns = zip(one.rotation, other.rotation, strict=True)
    return any(abs((a - b + 180) % 360 - 180) > _MAX_TURN_DEG for a, b in turns)
