"""The actors of the fake world, with the interface of the real library's actors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import carla

from tests.support.fake_carla.scene import Solid
from unghost.capture.simulator import Box, Measurement, Vector

if TYPE_CHECKING:
    from tests.support.fake_carla.simulator import Simulator

SIZES = {
    "car": (2.4, 1.0, 0.75),
    "truck": (4.0, 1.5, 1.8),
    "van": (3.0, 1.0, 1.3),
    "bus": (5.1, 1.9, 1.65),
    "bicycle": (0.82, 0.3, 0.85),
    "walker": (0.188, 0.188, 0.93),
}
TAGS = {"car": 14, "truck": 15, "van": 15, "bus": 16, "bicycle": 19, "walker": 12}


class Actor:
    def __init__(
        self,
        simulator: Simulator,
        actor_id: int,
        type_id: str,
        attributes: Mapping[str, str],
        pose: carla.Transform,
        parent: Actor | None,
    ) -> None:
        self._simulator = simulator
        self.id, self.type_id, self.attributes = actor_id, type_id, attributes
        self.pose, self.parent = pose, parent
        self.is_alive, self.is_active, self.is_dormant = True, True, False
        kind = attributes.get("base_type") or type_id.split(".")[0]
        self.kind = kind
        self.semantic_tags = [TAGS[kind]] if kind in TAGS else []

    @property
    def bounding_box(self) -> carla.BoundingBox:
        if self.id in self._simulator.faults.boxless or not self.is_alive:
            raise RuntimeError("trying to operate on a destroyed actor")
        x, y, z = SIZES.get(self.kind, (0.0, 0.0, 0.0))
        if self.kind == "bicycle":
            # CARLA's boxes of bicycles are wrong like this: no width, and far from it.
            return carla.BoundingBox(carla.Location(0, 40, 0), carla.Vector3D(x, 0, z))
        height = 0.0 if self.kind == "walker" else z
        return carla.BoundingBox(carla.Location(0, 0, height), carla.Vector3D(x, y, z))

    def solid(self) -> Solid | None:
        """The solid that rays hit, or None for an actor without a body."""
        if self.kind not in SIZES or self.is_dormant:
            return None
        x, y, z = SIZES[self.kind]
        centre = (0.0, 0.0, 0.0 if self.kind == "walker" else z)
        pose = self.get_transform()
        return Solid(pose, centre, (x, y, z), TAGS[self.kind], self.id)

    def get_transform(self) -> carla.Transform:
        if self.parent is None:
            return carla.Transform(self.pose.location, self.pose.rotation)
        # In the tests, all mounted actors are level and look forward.
        under = self.parent.get_transform()
        here = self.pose.location
        # The library changes the point that it is given, so it gets a copy.
        place = under.transform(carla.Location(here.x, here.y, here.z))
        return carla.Transform(
            carla.Location(place.x, place.y, place.z), under.rotation
        )

    def destroy(self) -> bool:
        return self._simulator.remove(self.id)


class Vehicle(Actor):
    autopilot = False
    light_state: object = carla.VehicleLightState.NONE

    def set_autopilot(self, enabled: bool = True, tm_port: int = 8000) -> None:
        assert tm_port in self._simulator.managers_synchronous
        self.autopilot = enabled

    def set_light_state(self, light_state: object) -> None:
        assert isinstance(light_state, carla.VehicleLightState)
        self.light_state = light_state

    def get_light_state(self) -> object:
        return self.light_state


class Walker(Actor):
    pass


class WalkerAIController(Actor):
    walking = False
    speed = 0.0

    def start(self) -> None:
        self.walking = True

    def stop(self) -> None:
        self.walking = False

    def go_to_location(self, destination: Vector) -> None:
        assert self.walking
        assert isinstance(destination, carla.Location)

    def set_max_speed(self, speed: float) -> None:
        self.speed = speed


class TrafficLight(Actor):
    heads: Sequence[Box] = ()

    def get_light_boxes(self) -> list[Box]:
        if self._simulator.faults.no_light_boxes:
            raise RuntimeError("Actor could not be found in the registry")
        return list(self.heads)


class Sensor(Actor):
    _callback: Callable[[Measurement], None] | None = None

    def listen(self, callback: Callable[[Measurement], None]) -> None:
        self._callback = callback

    def stop(self) -> None:
        self._callback = None

    def is_listening(self) -> bool:
        return self._callback is not None

    def receive(self, measurement: Measurement) -> None:
        """Pass a measurement to the callback; a stopped sensor has none."""
        callback = self._callback
        if callback is not None:
            callback(measurement)
