"""The module `carla` in front of a fake simulator."""

from __future__ import annotations

import types
from dataclasses import dataclass
from fnmatch import fnmatchcase

import carla as real

from tests.capture.fake_carla import actors, catalogue, measurements
from tests.capture.fake_carla.simulator import Simulator

VALUES = (
    "AttachmentType", "BoundingBox", "CityObjectLabel", "Location", "MapLayer",
    "RadarDetection", "Rotation", "Transform", "Vector3D", "VehicleLightState",
    "WeatherParameters", "WorldSettings",
)  # fmt: skip
"""What the real library gives without a simulator."""


def as_library(simulator: Simulator) -> types.ModuleType:
    """What `import carla` finds; its client speaks to this simulator."""
    module = types.ModuleType("carla")

    class Bound(Client):
        _simulator = simulator

    values = {name: getattr(real, name) for name in VALUES}
    for name, value in {**values, "command": real.command, "Client": Bound}.items():
        setattr(module, name, value)
    return module


class Client:
    _simulator: Simulator

    def __init__(self, host="127.0.0.1", port=2000, worker_threads=0):
        self._port = port

    def set_timeout(self, seconds):
        assert seconds > 0

    def get_server_version(self):
        self._simulator.answer()
        return self._simulator.version

    def get_client_version(self):
        return self._simulator.client_version

    def get_world(self):
        return World(self._simulator)

    def get_available_maps(self):
        return [f"/Game/Carla/Maps/{name}" for name in self._simulator.maps]

    def load_world(self, map_name, reset_settings=True, map_layers=real.MapLayer.All):
        self._simulator.map_name = f"Carla/Maps/{map_name}"
        return World(self._simulator)

    def get_trafficmanager(self, port=8000):
        return TrafficManager(self._simulator, port)

    def apply_batch_sync(self, commands, do_tick=False):
        self._simulator.answer()
        return [self._answer(command) for command in commands]

    def _answer(self, command):
        assert isinstance(command, real.command.DestroyActor)
        gone = self._simulator.remove(command.actor_id)
        error = "" if gone else "unable to destroy actor: not found"
        return Response(command.actor_id, error)


@dataclass
class Response:
    actor_id: int
    error: str

    def has_error(self):
        return bool(self.error)


class TrafficManager:
    def __init__(self, simulator, port):
        self._simulator, self._port = simulator, port
        simulator.managers_synchronous.setdefault(port, False)

    def get_port(self):
        return self._port

    def set_synchronous_mode(self, mode_switch):
        self._simulator.managers_synchronous[self._port] = mode_switch

    def set_random_device_seed(self, value):
        assert isinstance(value, int)

    def set_global_distance_to_leading_vehicle(self, distance):
        assert distance >= 0

    def global_percentage_speed_difference(self, percentage):
        assert percentage <= 100

    def set_hybrid_physics_mode(self, enabled):
        assert isinstance(enabled, bool)

    def set_hybrid_physics_radius(self, r):
        assert r > 0

    def set_respawn_dormant_vehicles(self, mode_switch):
        assert isinstance(mode_switch, bool)

    def update_vehicle_lights(self, actor, do_update):
        assert isinstance(actor, actors.Vehicle)


class Map:
    def __init__(self, simulator):
        self.name = simulator.map_name
        self._points = simulator.spawn_points

    def get_spawn_points(self):
        return list(self._points)


class ActorList:
    def __init__(self, found):
        self._found = list(found)

    def filter(self, wildcard_pattern):
        return ActorList(
            a for a in self._found if fnmatchcase(a.type_id, wildcard_pattern)
        )

    def find(self, id):
        return next((a for a in self._found if a.id == id), None)

    def __iter__(self):
        return iter(self._found)

    def __len__(self):
        return len(self._found)

    def __getitem__(self, arg2):
        return self._found[arg2]


class ActorSnapshot:
    def __init__(self, actor):
        self.id, self._pose = actor.id, actor.get_transform()

    def get_transform(self):
        return self._pose


@dataclass
class Timestamp:
    frame: int
    elapsed_seconds: float
    delta_seconds: float
    platform_timestamp: float


class WorldSnapshot:
    def __init__(self, simulator):
        self.frame = simulator.frame
        self.id = 1
        delta = simulator.settings.fixed_delta_seconds or 0.05
        self.timestamp = Timestamp(self.frame, self.frame * delta, delta, 0.0)
        there = (
            actor
            for actor in simulator.actors.values()
            if actor.id not in simulator.faults.unsnapped
        )
        self._actors = {actor.id: ActorSnapshot(actor) for actor in there}

    def find(self, actor_id):
        return self._actors.get(actor_id)

    def has_actor(self, actor_id):
        return actor_id in self._actors

    def __iter__(self):
        return iter(self._actors.values())

    def __len__(self):
        return len(self._actors)


@dataclass
class EnvironmentObject:
    id: int
    name: str
    type: real.CityObjectLabel
    transform: real.Transform
    bounding_box: real.BoundingBox


class World:
    id = 1

    def __init__(self, simulator):
        self._simulator = simulator

    def get_settings(self):
        self._simulator.answer()
        return _copied(self._simulator.settings)

    def apply_settings(self, settings, seconds=0.0):
        self._simulator.answer()
        self._simulator.settings = _copied(settings)
        return self._simulator.frame

    def tick(self, seconds=0.0):
        if not self._simulator.settings.synchronous_mode:
            raise RuntimeError("tick in asynchronous mode")
        self._simulator.answer()
        return self._simulator.tick()

    def get_snapshot(self):
        return WorldSnapshot(self._simulator)

    def get_map(self):
        return Map(self._simulator)

    def get_weather(self):
        return self._simulator.weather

    def set_weather(self, arg2):
        assert isinstance(arg2, real.WeatherParameters)
        self._simulator.answer()
        self._simulator.weather = arg2

    def get_blueprint_library(self):
        return catalogue.BlueprintLibrary()

    def spawn_actor(
        self,
        blueprint,
        transform,
        attach_to=None,
        attachment_type=real.AttachmentType.Rigid,
        bone="",
    ):
        solid = blueprint.id.startswith(("vehicle.", "walker."))
        if solid and self._simulator.is_taken(transform):
            raise RuntimeError("Spawn failed because of collision at spawn position")
        attributes = blueprint.attributes
        return self._simulator.add(blueprint.id, attributes, transform, attach_to)

    def try_spawn_actor(
        self,
        blueprint,
        transform,
        attach_to=None,
        attachment_type=real.AttachmentType.Rigid,
        bone="",
    ):
        try:
            return self.spawn_actor(blueprint, transform, attach_to, attachment_type)
        except RuntimeError:
            return None

    def get_actors(self):
        return ActorList(self._simulator.actors.values())

    def get_actor(self, actor_id):
        return self._simulator.actors.get(actor_id)

    def get_environment_objects(self, object_type=real.CityObjectLabel.Any):
        return [o for o in self._simulator.environment if o.type == object_type]

    def get_level_bbs(self, bb_type=real.CityObjectLabel.Any):
        return list(self._simulator.level_boxes)

    def get_random_location_from_navigation(self):
        places = self._simulator.sidewalk
        if places:
            # In turn, as if by chance.
            places.append(places.pop(0))
            return places[-1]
        return None

    def set_pedestrians_seed(self, seed):
        self._simulator.pedestrian_seed = seed

    def set_pedestrians_cross_factor(self, percentage):
        assert 0 <= percentage <= 1

    def load_map_layer(self, map_layers):
        self._simulator.layers_off.remove(str(map_layers))

    def unload_map_layer(self, map_layers):
        self._simulator.layers_off.append(str(map_layers))


def _copied(settings):
    """Settings are values: what a client changes is its own copy."""
    copy = real.WorldSettings()
    for name in _SETTINGS:
        setattr(copy, name, getattr(settings, name))
    return copy


_SETTINGS = (
    "synchronous_mode", "no_rendering_mode", "fixed_delta_seconds", "substepping",
    "max_substep_delta_time", "max_substeps", "max_culling_distance",
    "deterministic_ragdolls", "tile_stream_distance", "actor_active_distance",
)  # fmt: skip
FAKES = {
    "Client": Client,
    "World": World,
    "WorldSnapshot": WorldSnapshot,
    "ActorSnapshot": ActorSnapshot,
    "TrafficManager": TrafficManager,
    "Map": Map,
    "ActorList": ActorList,
    "EnvironmentObject": EnvironmentObject,
    "BlueprintLibrary": catalogue.BlueprintLibrary,
    "ActorBlueprint": catalogue.ActorBlueprint,
    "ActorAttribute": catalogue.ActorAttribute,
    "Actor": actors.Actor,
    "Vehicle": actors.Vehicle,
    "Walker": actors.Walker,
    "WalkerAIController": actors.WalkerAIController,
    "TrafficLight": actors.TrafficLight,
    "Sensor": actors.Sensor,
    "Image": measurements.Image,
    "LidarMeasurement": measurements.LidarMeasurement,
    "SemanticLidarMeasurement": measurements.SemanticLidarMeasurement,
    "RadarMeasurement": measurements.RadarMeasurement,
}
"""The fake's classes by the names of the real ones."""
