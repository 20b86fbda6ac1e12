"""The fake simulator: its world, its clock, and faults that tests can switch on."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from queue import SimpleQueue
from typing import TYPE_CHECKING

import carla

from tests.support.fake_carla.actors import (
    Actor,
    Sensor,
    TrafficLight,
    Vehicle,
    Walker,
    WalkerAIController,
)
from tests.support.fake_carla.measurements import MEASUREMENTS, Image, Shared
from tests.support.fake_carla.scene import Solid
from unghost.capture.simulator import Measurement

if TYPE_CHECKING:
    from tests.support.fake_carla.library import EnvironmentObject

_CLASSES = (
    ("vehicle.", Vehicle),
    ("walker.", Walker),
    ("controller.", WalkerAIController),
    ("sensor.", Sensor),
    ("traffic.traffic_light", TrafficLight),
)


def at(x=0.0, y=0.0, z=0.0, yaw=0.0):
    """A pose in the world."""
    return carla.Transform(carla.Location(x, y, z), carla.Rotation(yaw=yaw))


@dataclass
class Faults:
    """What goes wrong in the simulator; ticks are counted from 1.

    Attributes
    ----------
    lost, late : set of (sensor's last word, tick)
        This sensor's measurement of this tick is never sent, or only at the next tick.
    pose_shift : metres
        By how much the transform that is reported for an RGB image is wrong.
    on_tick : called with the simulator and the number of the tick
    boxless : ids of actors whose bounding_box raises
    unsnapped : ids of actors that no snapshot has
    no_light_boxes : get_light_boxes raises, as on some maps
    foreign_ticks : ticks at which another client ticks, too
    gone : no request is answered, as after a crash of the simulator
    """

    lost: set[tuple[str, int]] = field(default_factory=set)
    late: set[tuple[str, int]] = field(default_factory=set)
    pose_shift: float = 0.0
    on_tick: Callable[[Simulator, int], None] = lambda _simulator, _tick: None
    boxless: set[int] = field(default_factory=set)
    unsnapped: set[int] = field(default_factory=set)
    no_light_boxes: bool = False
    foreign_ticks: set[int] = field(default_factory=set)
    gone: bool = False


class Simulator:
    """The state of the server's side: actors, solids, weather, settings, ticks."""

    def __init__(self, version: str = "0.9.16", client_version: str | None = None):
        self.version, self.client_version = version, client_version or version
        self.faults = Faults()
        self.settings = carla.WorldSettings()
        self.weather = carla.WeatherParameters.ClearNoon
        self.map_name = "Carla/Maps/Town10HD"
        self.maps = [*(f"Town{number:02}" for number in range(1, 8)), "Town10HD"]
        self.layers_off: list[str] = []
        self.frame, self.ticks, self.next_id = 1000, 0, 20
        self.speed = 0.0
        self.actors: dict[int, Actor] = {}
        self.environment: list[EnvironmentObject] = []
        self.level_boxes: list[carla.BoundingBox] = []
        self.solids: list[Solid] = []
        self.spawn_points: list[carla.Transform] = []
        self.sidewalk: list[carla.Location] = []
        self.managers_synchronous: dict[int, bool] = {}
        self.pedestrian_seed: int | None = None
        self.spawned: list[str] = []
        self.listeners: dict[int, Callable[[], None]] = {}
        self.unanswered = 0
        self._held: list[tuple[Sensor, Measurement]] = []
        self._mail: SimpleQueue[tuple[Sensor, Measurement] | None] = SimpleQueue()
        self._postman = threading.Thread(target=self._deliver, daemon=True)
        self._postman.start()

    def answer(self) -> None:
        """Stands for the server's answer to a request: raises if it has crashed."""
        if self.faults.gone:
            self.unanswered += 1
            raise RuntimeError("time-out while waiting for the simulator")

    def add(
        self,
        type_id: str,
        attributes: Mapping[str, str],
        pose: carla.Transform,
        parent: Actor | None = None,
    ) -> Actor:
        """Create an actor of this type, and return it."""
        made = next(cls for start, cls in _CLASSES if type_id.startswith(start))
        self.next_id += 1
        actor = made(self, self.next_id, type_id, dict(attributes), pose, parent)
        self.actors[actor.id] = actor
        self.spawned.append(type_id)
        return actor

    def is_taken(self, pose: carla.Transform) -> bool:
        """Whether a vehicle or walker is at this place already."""
        return any(
            actor.get_transform().location.distance(pose.location) < 0.5
            for actor in self.actors.values()
            if actor.type_id.startswith(("vehicle.", "walker."))
        )

    def remove(self, actor_id: int) -> bool:
        """Remove an actor; False if there was none with this id."""
        actor = self.actors.pop(actor_id, None)
        if actor is None:
            return False
        actor.is_alive = False
        return True

    def tick(self) -> int:
        """Advance one tick: move vehicles, then measure. Returns the frame's number."""
        self.ticks += 1
        self.faults.on_tick(self, self.ticks)
        self.frame += 1
        self._move()
        mail, self._held, shared = self._held, [], Shared()
        for sensor in [a for a in self.actors.values() if isinstance(a, Sensor)]:
            if sensor.is_listening():
                self._measure(sensor, mail, shared)
        for listener in list(self.listeners.values()):
            listener()
        for message in mail:
            self._mail.put(message)
        frame = self.frame
        if self.ticks in self.faults.foreign_ticks:
            self.frame += 1
        return frame

    def _move(self):
        step = self.speed * (self.settings.fixed_delta_seconds or 0.05)
        for actor in self.actors.values():
            if isinstance(actor, Vehicle) and actor.autopilot:
                ahead = actor.pose.transform(carla.Location(x=step))
                actor.pose = carla.Transform(
                    carla.Location(ahead.x, ahead.y, ahead.z), actor.pose.rotation
                )

    def _measure(self, sensor, mail, shared):
        word = sensor.type_id.rsplit(".", 1)[-1]
        if (word, self.ticks) in self.faults.lost:
            return
        said = true = sensor.get_transform()
        if self.faults.pose_shift and word == "rgb":
            said = at(true.location.x + self.faults.pose_shift, true.location.y)
            said.location.z, said.rotation = true.location.z, true.rotation
        made = MEASUREMENTS.get(sensor.type_id, Image)
        shot = made(
            frame=self.frame,
            timestamp=self.frame * 0.05,
            transform=said,
            solids=self.visible_solids(sensor.parent),
            attributes=sensor.attributes,
            kind=sensor.type_id,
            true_pose=true,
            shared=shared,
        )
        late = (word, self.ticks) in self.faults.late
        (self._held if late else mail).append((sensor, shot))

    def visible_solids(self, without):
        """All solids of the world at this moment, without the actor `without`."""
        moving = (
            actor.solid() for actor in self.actors.values() if actor is not without
        )
        return (*self.solids, *(solid for solid in moving if solid is not None))

    def _deliver(self):
        # As in the real library, callbacks run in another thread.
        while (message := self._mail.get()) is not None:
            sensor, shot = message
            sensor.receive(shot)

    def close(self):
        """End the thread that delivers measurements."""
        self._mail.put(None)
        self._postman.join()
