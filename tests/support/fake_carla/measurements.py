"""What the fake sensors deliver; pixels are computed when they are first read."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from threading import Lock

import carla
import numpy as np

from tests.support.fake_carla.scene import FAR_M, cast, rays
from unghost.capture.simulator import Detection

_COLORS = {1: (128, 64, 128), 3: (70, 70, 70), 11: (70, 130, 180), 12: (220, 20, 60)}


@dataclass
class Shared:
    """Views that the measurements of one tick share, so that each is computed once."""

    lock: Lock = field(default_factory=Lock)
    views: dict = field(default_factory=dict)


@dataclass
class Shot:
    """One measurement of a sensor at one tick."""

    frame: int
    timestamp: float
    transform: carla.Transform
    solids: tuple
    attributes: dict
    kind: str
    shared: Shared

    @property
    def _pose(self):
        return self.true_pose or self.transform

    true_pose: carla.Transform | None = None


class Image(Shot):
    @property
    def width(self) -> int:
        return int(self.attributes["image_size_x"])

    @property
    def height(self) -> int:
        return int(self.attributes["image_size_y"])

    @property
    def fov(self) -> float:
        return float(self.attributes["fov"])

    @cached_property
    def raw_data(self) -> memoryview:
        # All cameras of a tick are at one place: cast the rays once for all of them.
        with self.shared.lock:
            key = (self.width, self.height, self.fov, *self._pose.get_matrix()[0])
            if key not in self.shared.views:
                directions = rays(self.width, self.height, self.fov)
                self.shared.views[key] = cast(self.solids, self._pose, directions)
            depth, tag, owner = self.shared.views[key]
        pixels = np.full((self.height, self.width, 4), 255, np.uint8)
        pixels[..., :3] = self._bgr(depth, tag, owner)
        return memoryview(pixels.tobytes())

    def _bgr(self, depth, tag, owner):
        zero = np.zeros_like(tag)
        if self.kind.endswith("semantic_segmentation"):
            return np.stack([zero, zero, tag], axis=-1)
        if self.kind.endswith("instance_segmentation"):
            return np.stack([owner >> 8 & 255, owner & 255, tag], axis=-1)
        if self.kind.endswith("depth"):
            steps = np.rint(depth / FAR_M * (2**24 - 1)).astype(np.int64)
            return np.stack([steps >> 16, steps >> 8 & 255, steps & 255], axis=-1)
        table = np.full((256, 3), 90, np.uint8)
        for color_tag, rgb in _COLORS.items():
            table[color_tag] = rgb[::-1]
        return table[tag]


class LidarMeasurement(Shot):
    """The points that a ring of beams hits, with tags if the LiDAR is semantic."""

    @cached_property
    def raw_data(self) -> memoryview:
        turn = np.radians(np.arange(0, 360, 3.0))
        tilt = np.radians(np.linspace(-20, 0, 8))
        t, e = np.meshgrid(turn, tilt)
        to = np.stack([np.cos(e) * np.cos(t), np.cos(e) * np.sin(t), np.sin(e)], -1)
        distance, tag, owner = cast(self.solids, self._pose, to)
        hit = distance < float(self.attributes["range"])
        places = (to * distance[..., None])[hit].astype("<f4")
        if not self.kind.endswith("semantic"):
            shine = np.ones((len(places), 1), "<f4")
            return memoryview(np.hstack([places, shine]).tobytes())
        table = np.zeros(len(places), np.dtype("<f4,<f4,<f4,<f4,<u4,<u4"))
        table["f0"], table["f1"], table["f2"] = places.T
        table["f4"], table["f5"] = owner[hit], tag[hit]
        return memoryview(table.tobytes())


class SemanticLidarMeasurement(LidarMeasurement):
    pass


class RadarMeasurement(Shot):
    """Three detections at known places."""

    _detections = (
        (-2.0, 0.1, 0.05, 10.0),
        (0.0, -0.2, 0.0, 25.0),
        (4.0, 0.0, 0.1, 50.0),
    )

    def __iter__(self) -> Iterator[Detection]:
        for velocity, azimuth, altitude, depth in self._detections:
            detection = carla.RadarDetection()
            detection.velocity, detection.azimuth = velocity, azimuth
            detection.altitude, detection.depth = altitude, depth
            yield detection

    def __len__(self) -> int:
        return len(self._detections)


MEASUREMENTS = {
    "sensor.lidar.ray_cast": LidarMeasurement,
    "sensor.lidar.ray_cast_semantic": SemanticLidarMeasurement,
    "sensor.other.radar": RadarMeasurement,
}
