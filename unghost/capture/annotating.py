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
        measured: dict[str, Transform] = {}
        in_snapshot: dict[str, Transform] = {}
        for sensor in self.sensors:
            name, actor = sensor.name, moment.snapshot.find(sensor.actor.id)
            measured[name] = as_transform(moment.measured[name].transform)
            # The sensor itself has a pose, too, if the snapshot lacks it.
            there = sensor.actor if actor is None else actor
            in_snapshot[name] = as_transform(there.get_transform())
        is_lagging = has_wrong_metadata(session.server_version)
        used = in_snapshot if is_lagging else measured
        main = main_camera(session.scenario)
        self.poses_differ += differs(measured[main], in_snapshot[main])
        poses = {
            "image": measured[main].as_dict(),
            "snapshot": in_snapshot[main].as_dict(),
            "used": "snapshot" if is_lagging else "image",
        }
        shown = as_image(moment.measured[main])
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
            centres - used[main].location, axis=1
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
                "transform": used[main].as_dict(),
            },
            "sensors": {
                MANIFEST_KEYS[name]: {"transform": used[name].as_dict()}
                for name in _POINT_SENSORS
                if name in used
            },
            "boxes": boxes,
            "extra": {
                "capture": {
                    **self._story(moment, poses),
                    "missed_before": missed_before,
                }
            },
            "captured_at": captured_at,
        }

    def _story(self, moment: Moment, poses: Mapping[str, object]) -> dict[str, object]:
        snapshot, session = moment.snapshot, self.session
        story: dict[str, object] = {
            "frame": snapshot.frame,
            "elapsed_s": round(snapshot.timestamp.elapsed_seconds, 6),
            "client_version": session.client_version,
            "poses": poses,
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


def differs(pose: Transform, other: Transform) -> bool:
    """Further apart than a centimetre, or turned by more than a tenth of a degree."""
    if math.dist(pose.location, other.location) > _MAX_SHIFT_M:
        return True
    turns = zip(pose.rotation, other.rotation, strict=True)
    return any(abs((a - b + 180) % 360 - 180) > _MAX_TURN_DEG for a, b in turns)
