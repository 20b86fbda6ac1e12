"""The annotation of one recorded tick: camera, sensors, boxes, and their origin.

CARLA gives the pose of a sensor twice: in its measurement and in the snapshot of the
world. Both are stored; CARLA's version decides which one the boxes are projected with.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from filter_core.arrays import FloatArray
from filter_core.geometry.box3d import boxes3d_vertices
from filter_core.geometry.pose import Transform, Triple
from unghost.capture.boxes import ActorBoxes, map_boxes, without_duplicates
from unghost.capture.folder import MANIFEST_KEYS, FrameRecord
from unghost.capture.objects import SeenObject
from unghost.capture.rig import RunningSensor, main_camera
from unghost.capture.session import Scene
from unghost.capture.simulator import (
    Actor,
    Measurement,
    WorldSnapshot,
    as_image,
    as_transform,
    has_wrong_metadata,
)
from unghost.capture.weather import as_numbers

_POINT_SENSORS: Final = ("semantic_lidar", "lidar", "radar")
_MAX_SHIFT_M: Final = 0.01
_MAX_TURN_DEG: Final = 0.1


@dataclass(frozen=True, eq=False)
class Moment:
    """The measurements of one tick, by the sensors' names.

    `before` and `after` are neighbouring ticks, if images may show those instead.
    """

    snapshot: WorldSnapshot
    measured: Mapping[str, Measurement]
    before: WorldSnapshot | None = None
    after: WorldSnapshot | None = None


@dataclass(eq=False)
class Annotator:
    """Makes the annotations of moments.

    `left_out` counts objects without a box by reason, `poses_differ` the frames whose
    image had another camera pose than the snapshot.
    """

    session: Scene
    ego: Actor
    sensors: Sequence[RunningSensor]
    left_out: Counter[str] = field(default_factory=Counter)
    poses_differ: int = 0

    def __post_init__(self) -> None:
        session = self.session
        version = session.server_version
        self._actors = ActorBoxes(session.world, session.scenario, version)
        self._static = map_boxes(
            session.carla, session.world, session.scenario, self.left_out
        )
        self._static_centres = _centres(self._static)

    def annotate(
        self,
        moment: Moment,
        *,
        captured_at: str,
        missed_before: int,
        preset: str | None = None,
    ) -> FrameRecord:
        """The frame's line in the manifest; `captured_at` is ISO 8601, UTC.

        `missed_before` are the ticks of this capture that could not be recorded so far,
        `preset` is the name of the weather's.
        """
        session, camera = self.session, self.session.scenario.camera
        version, snapshot = self.session.server_version, moment.snapshot
        poses = {
            sensor.name: sensor_pose(
                moment.measured[sensor.name], sensor.actor, snapshot, version
            )
            for sensor in self.sensors
        }
        main = poses[main_camera(session.scenario)]
        self.poses_differ += main.differs
        shown = as_image(moment.measured[main_camera(session.scenario)])
        rules = self.session.scenario.boxes
        actors = self._actors.seen(moment.snapshot, self.ego.id, self.left_out)
        taken = _centres(actors)
        static = without_duplicates(
            self._static, self._static_centres, taken, self.left_out
        )
        objects = [*actors, *static]
        boxes = []
        centres = _corners(objects).mean(axis=1)
        metres: list[float] = np.linalg.norm(
            centres - main.used.location, axis=1
        ).tolist()
        for seen, distance in zip(objects, metres, strict=True):
            if rules.min_distance <= distance <= rules.max_distance:
                boxes.append(seen.as_annotation(distance, rules.bands))
            else:
                self.left_out["out_of_range"] += 1
        return {
            "carla_version": session.server_version,
            "map": session.map_name,
            "weather": {
                **({"preset": preset} if preset else {}),
                **as_numbers(session.world.get_weather()),
            },
            "camera": {
                "width": shown.width,
                "height": shown.height,
                "fov": camera.fov,
                "transform": main.used.as_dict(),
            },
            "sensors": {
                MANIFEST_KEYS[name]: {"transform": poses[name].used.as_dict()}
                for name in _POINT_SENSORS
                if name in poses
            },
            "boxes": boxes,
            "extra": {
                "capture": {**self._story(moment, main), "missed_before": missed_before}
            },
            "captured_at": captured_at,
        }

    def _story(self, moment: Moment, main: SensorPose) -> dict[str, object]:
        snapshot, session = moment.snapshot, self.session
        story: dict[str, object] = {
            "frame": snapshot.frame,
            "elapsed_s": round(snapshot.timestamp.elapsed_seconds, 6),
            "client_version": session.client_version,
            "poses": {
                "image": main.measured.as_dict(),
                "snapshot": main.snapshot.as_dict(),
                "used": "image" if main.used is main.measured else "snapshot",
            },
            "ego": self._pose_in(snapshot, self.ego.id),
        }
        for name, other in (("before", moment.before), ("after", moment.after)):
            if other is not None:
                story[name] = self._neighbour(other)
        return story

    def _neighbour(self, snapshot: WorldSnapshot) -> dict[str, object]:
        """Poses one tick earlier or later, which show a lag of the images."""
        camera = main_camera(self.session.scenario)
        sensor = next(
            running.actor.id for running in self.sensors if running.name == camera
        )
        actors = {
            str(actor.id): as_transform(actor.get_transform()).as_dict()
            for actor in snapshot
            if actor.id in self._actors.known_ids
        }
        return {"camera": self._pose_in(snapshot, sensor), "actors": actors}

    def _pose_in(
        self, snapshot: WorldSnapshot, actor_id: int
    ) -> dict[str, float] | None:
        actor = snapshot.find(actor_id)
        return None if actor is None else as_transform(actor.get_transform()).as_dict()


def _corners(objects: Sequence[SeenObject]) -> FloatArray:
    return boxes3d_vertices(np.array([seen.row for seen in objects]).reshape(-1, 15))


def _centres(objects: Sequence[SeenObject]) -> list[Triple]:
    return [(c[0], c[1], c[2]) for c in _corners(objects).mean(axis=1).tolist()]


@dataclass(frozen=True)
class SensorPose:
    """The pose of a sensor, from its measurement and from the snapshot."""

    measured: Transform
    snapshot: Transform
    """The actor's own if the snapshot has none."""
    used: Transform
    """The one to project with."""

    @property
    def differs(self) -> bool:
        """Whether they differ by more than rounding errors."""
        return differs(self.measured, self.snapshot)


def sensor_pose(
    measurement: Measurement, sensor: Actor, snapshot: WorldSnapshot, version: str
) -> SensorPose:
    """The poses of a sensor at one tick; which one is used depends on the version."""
    measured = as_transform(measurement.transform)
    actor = snapshot.find(sensor.id)
    there = as_transform((sensor if actor is None else actor).get_transform())
    used = there if has_wrong_metadata(version) else measured
    return SensorPose(measured, there, used)


def differs(pose: Transform, other: Transform) -> bool:
    """Further apart than a centimetre, or turned by more than a tenth of a degree."""
    if math.dist(pose.location, other.location) > _MAX_SHIFT_M:
        return True
    turns = zip(pose.rotation, other.rotation, strict=True)
    return any(abs((a - b + 180) % 360 - 180) > _MAX_TURN_DEG for a, b in turns)
