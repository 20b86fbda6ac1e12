"""The actors of the fake world, as the library shows them."""

from __future__ import annotations

import carla

from tests.capture.fake_carla.scene import Solid

SIZES = {
    "car": (2.4, 1.0, 0.75),
    "bus": (5.1, 1.9, 1.65),
    "bicycle": (0.82, 0.3, 0.85),
    "walker": (0.188, 0.188, 0.93),
}
TAGS = {"car": 14, "bus": 16, "bicycle": 19, "walker": 12}


class Actor:
    def __init__(self, simulator, actor_id, type_id, attributes, pose, parent):
        self._simulator = simulator
        self.id, self.type_id, self.attributes = actor_id, type_id, attributes
        self.pose, self.parent = pose, parent
        self.is_alive, self.is_active, self.is_dormant = True, True, False
        kind = attributes.get("base_type") or type_id.split(".")[0]
        self.kind = kind
        self.semantic_tags = [TAGS[kind]] if kind in TAGS else []

    @property
    def bounding_box(self):
        if self.id in self._simulator.faults.boxless or not self.is_alive:
            raise RuntimeError("trying to operate on a destroyed actor")
        x, y, z = SIZES.get(self.kind, (0.0, 0.0, 0.0))
        if self.kind == "bicycle":
            # As CARLA gives them: no width, and a place somewhere else.
            return carla.BoundingBox(carla.Location(0, 40, 0), carla.Vector3D(x, 0, z))
        height = 0.0 if self.kind == "walker" else z
        return carla.BoundingBox(carla.Location(0, 0, height), carla.Vector3D(x, y, z))

    def solid(self):
        """What of it stops light, if anything."""
        if self.kind not in SIZES or self.is_dormant:
            return None
        x, y, z = SIZES[self.kind]
        centre = (0.0, 0.0, 0.0 if self.kind == "walker" else z)
        pose = self.get_transform()
        return Solid(pose, centre, (x, y, z), TAGS[self.kind], self.id)

    def get_transform(self):
        if self.parent is None:
            return carla.Transform(self.pose.location, self.pose.rotation)
        # All mounts of the tests are level and look forward.
        under = self.parent.get_transform()
        here = self.pose.location
        # The library moves the point that it is given, so it gets one of its own.
        place = under.transform(carla.Location(here.x, here.y, here.z))
        return carla.Transform(
            carla.Location(place.x, place.y, place.z), under.rotation
        )

    def get_location(self):
        return self.get_transform().location

    def destroy(self):
        return self._simulator.remove(self.id)


class Vehicle(Actor):
    autopilot = False
    light_state = carla.VehicleLightState.NONE

    def set_autopilot(self, enabled=True, tm_port=8000):
        assert tm_port in self._simulator.managers_synchronous
        self.autopilot = enabled

    def set_light_state(self, light_state):
        assert isinstance(light_state, carla.VehicleLightState)
        self.light_state = light_state

    def get_light_state(self):
        return self.light_state


class Walker(Actor):
    pass


class WalkerAIController(Actor):
    walking = False
    speed = 0.0

    def start(self):
        self.walking = True

    def stop(self):
        self.walking = False

    def go_to_location(self, destination):
        assert self.walking
        assert isinstance(destination, carla.Location)

    def set_max_speed(self, speed):
        self.speed = speed


class TrafficLight(Actor):
    heads = ()

    def get_light_boxes(self):
        if self._simulator.faults.no_light_boxes:
            raise RuntimeError("Actor could not be found in the registry")
        return list(self.heads)


class Sensor(Actor):
    _callback = None

    def listen(self, callback):
        self._callback = callback

    def stop(self):
        self._callback = None

    def is_listening(self):
        return self._callback is not None

    def receive(self, measurement):
        """What the simulator calls; a sensor that was stopped stays silent."""
        callback = self._callback
        if callback is not None:
            callback(measurement)
