"""A module `carla` whose client talks to a fake simulator."""

from __future__ import annotations

import types
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import carla as real

from tests.support.fake_carla import actors, catalogue, measurements
from tests.support.fake_carla.simulator import Simulator
from unghost.capture import simulator as known


class Library(types.ModuleType):
    """The module; what needs no simulator is taken from the real library."""

    Client: Callable[[str, int], known.Client]
    AttachmentType = real.AttachmentType
    BoundingBox = real.BoundingBox
    CityObjectLabel = real.CityObjectLabel
    Location = real.Location
    MapLayer = real.MapLayer
    RadarDetection = real.RadarDetection
    Rotation = real.Rotation
    Transform = real.Transform
    Vector3D = real.Vector3D
    VehicleLightState = real.VehicleLightState
    WeatherParameters = real.WeatherParameters
    WorldSettings = real.WorldSettings
    command = real.command

    def __init__(self, simulator: Simulator) -> None:
        super().__init__("carla")

        class Bound(Client):
            _simulator = simulator

        self.Client = Bound


def as_library(simulator: Simulator) -> Library:
    """The module that `import carla` shall find; its client talks to this simulator."""
    library: known.Carla = Library(simulator)
    assert isinstance(library, Library)
    return library


class Client:
    _simulator: Simulator

    def __init__(
        self, host: str = "127.0.0.1", port: int = 2000, worker_threads: int = 0
    ) -> None:
        self._port = port

    def set_timeout(self, seconds: float) -> None:
        assert seconds > 0

    def get_server_version(self) -> str:
        self._simulator.answer()
        return self._simulator.version

    def get_client_version(self) -> str:
        return self._simulator.client_version

    def get_world(self) -> World:
        return World(self._simulator)

    def get_available_maps(self) -> list[str]:
        return [f"/Game/Carla/Maps/{name}" for name in self._simulator.maps]

    def load_world(
        self,
        map_name: str,
        reset_settings: bool = True,
        map_layers: object = real.MapLayer.All,
    ) -> World:
        self._simulator.map_name = f"Carla/Maps/{map_name}"
        return World(self._simulator)

    def get_trafficmanager(self, port: int = 8000) -> TrafficManager:
        return TrafficManager(self._simulator, port)

    def apply_batch_sync(
        self, commands: Sequence[object], do_tick: bool = False
    ) -> list[Response]:
        self._simulator.answer()
        return [self._answer(command) for command in commands]

    def _answer(self, command: real.command.DestroyActor) -> Response:
        assert isinstance(command, real.command.DestroyActor)
        gone = self._simulator.remove(command.actor_id)
        error = "" if gone else "unable to destroy actor: not found"
        return Response(command.actor_id, error)


@dataclass
class Response:
    actor_id: int
    error: str


class TrafficManager:
    def __init__(self, simulator: Simulator, port: int) -> None:
        self._simulator, self._port = simulator, port
        simulator.managers_synchronous.setdefault(port, False)

    def set_synchronous_mode(self, mode_switch: bool) -> None:
        self._simulator.managers_synchronous[self._port] = mode_switch

    def set_random_device_seed(self, value: int) -> None:
        assert isinstance(value, int)

    def set_global_distance_to_leading_vehicle(self, distance: float) -> None:
        assert distance >= 0

    def global_percentage_speed_difference(self, percentage: float) -> None:
        assert percentage <= 100

    def set_hybrid_physics_mode(self, enabled: bool) -> None:
        assert isinstance(enabled, bool)

    def set_hybrid_physics_radius(self, r: float) -> None:
        assert r > 0

    def set_respawn_dormant_vehicles(self, mode_switch: bool) -> None:
        assert isinstance(mode_switch, bool)

    def update_vehicle_lights(self, actor: known.Actor, do_update: bool) -> None:
        assert isinstance(actor, actors.Vehicle)


class Map:
    def __init__(self, simulator: Simulator) -> None:
        self.name = simulator.map_name
        self._points = simulator.spawn_points

    def get_spawn_points(self) -> list[known.Pose]:
        return list(self._points)


class ActorList:
    def __init__(self, members: Iterable[actors.Actor]) -> None:
        self._found = list(members)

    def filter(self, wildcard_pattern: str) -> ActorList:
        return ActorList(
            a for a in self._found if fnmatchcase(a.type_id, wildcard_pattern)
        )

    def find(self, id: int) -> actors.Actor | None:
        return next((a for a in self._found if a.id == id), None)

    def __iter__(self) -> Iterator[actors.Actor]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)

    def __getitem__(self, arg2: int) -> actors.Actor:
        return self._found[arg2]


class ActorSnapshot:
    def __init__(self, actor: actors.Actor) -> None:
        self.id, self._pose = actor.id, actor.get_transform()

    def get_transform(self) -> real.Transform:
        return self._pose


@dataclass
class Timestamp:
    frame: int
    elapsed_seconds: float


class WorldSnapshot:
    def __init__(self, simulator: Simulator) -> None:
        self.frame = simulator.frame
        self.id = 1
        delta = simulator.settings.fixed_delta_seconds or 0.05
        self.timestamp = Timestamp(self.frame, self.frame * delta)
        there = (
            actor
            for actor in simulator.actors.values()
            if actor.id not in simulator.faults.unsnapped
        )
        self._actors = {actor.id: ActorSnapshot(actor) for actor in there}

    def find(self, actor_id: int) -> ActorSnapshot | None:
        return self._actors.get(actor_id)

    def __iter__(self) -> Iterator[ActorSnapshot]:
        return iter(self._actors.values())

    def __len__(self) -> int:
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

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator

    def get_settings(self) -> real.WorldSettings:
        self._simulator.answer()
        return _copied(self._simulator.settings)

    def apply_settings(self, settings: known.Settings, seconds: float = 0.0) -> int:
        self._simulator.answer()
        self._simulator.settings = _copied(settings)
        return self._simulator.frame

    def tick(self, seconds: float = 0.0) -> int:
        if not self._simulator.settings.synchronous_mode:
            raise RuntimeError("tick in asynchronous mode")
        self._simulator.answer()
        return self._simulator.tick()

    def get_snapshot(self) -> WorldSnapshot:
        return WorldSnapshot(self._simulator)

    def on_tick(self, callback: Callable[[known.WorldSnapshot], None]) -> int:
        simulator = self._simulator
        listeners = simulator.listeners
        number = len(listeners) + 1
        listeners[number] = lambda: callback(WorldSnapshot(simulator))
        return number

    def remove_on_tick(self, callback_id: int) -> None:
        del self._simulator.listeners[callback_id]

    def get_map(self) -> Map:
        return Map(self._simulator)

    def get_weather(self) -> object:
        return self._simulator.weather

    def set_weather(self, arg2: object) -> None:
        assert isinstance(arg2, real.WeatherParameters)
        self._simulator.answer()
        self._simulator.weather = arg2

    def get_blueprint_library(self) -> catalogue.BlueprintLibrary:
        return catalogue.BlueprintLibrary()

    def spawn_actor(
        self,
        blueprint: known.Blueprint,
        transform: known.Pose,
        attach_to: known.Actor | None = None,
        attachment_type: object = real.AttachmentType.Rigid,
        bone: str = "",
    ) -> actors.Actor:
        assert isinstance(blueprint, catalogue.ActorBlueprint)
        assert attach_to is None or isinstance(attach_to, actors.Actor)
        solid = blueprint.id.startswith(("vehicle.", "walker."))
        if solid and self._simulator.is_taken(transform):
            raise RuntimeError("Spawn failed because of collision at spawn position")
        attributes = blueprint.attributes
        return self._simulator.add(blueprint.id, attributes, transform, attach_to)

    def try_spawn_actor(
        self,
        blueprint: known.Blueprint,
        transform: known.Pose,
        attach_to: known.Actor | None = None,
        attachment_type: object = real.AttachmentType.Rigid,
        bone: str = "",
    ) -> actors.Actor | None:
        try:
            return self.spawn_actor(blueprint, transform, attach_to, attachment_type)
        except RuntimeError:
            return None

    def get_actors(self) -> ActorList:
        return ActorList(self._simulator.actors.values())

    def get_environment_objects(
        self, object_type: object = real.CityObjectLabel.Any
    ) -> list[EnvironmentObject]:
        return [o for o in self._simulator.environment if o.type == object_type]

    def get_level_bbs(
        self, bb_type: object = real.CityObjectLabel.Any
    ) -> list[known.Box]:
        return list(self._simulator.level_boxes)

    def get_random_location_from_navigation(self) -> real.Location | None:
        places = self._simulator.sidewalk
        if places:
            # One place after the other, where the real library picks at random.
            places.append(places.pop(0))
            return places[-1]
        return None

    def set_pedestrians_seed(self, seed: int) -> None:
        self._simulator.pedestrian_seed = seed

    def set_pedestrians_cross_factor(self, percentage: float) -> None:
        assert 0 <= percentage <= 1

    def load_map_layer(self, map_layers: object) -> None:
        self._simulator.layers_off.remove(str(map_layers))

    def unload_map_layer(self, map_layers: object) -> None:
        self._simulator.layers_off.append(str(map_layers))


def _copied(settings: known.Settings) -> real.WorldSettings:
    """A copy, as in the real library: changing it does not change the simulator's."""
    copy = real.WorldSettings()
    for name in _SETTINGS:
        setattr(copy, name, getattr(settings, name))
    return copy


_SETTINGS = (
    "synchronous_mode", "no_rendering_mode", "fixed_delta_seconds", "substepping",
    "max_substep_delta_time", "max_substeps", "max_culling_distance",
    "deterministic_ragdolls", "tile_stream_distance", "actor_active_distance",
)  # fmt: skip
VALUES = tuple(name for name in vars(Library) if not name.startswith("_"))
"""The names that the fake library takes from the real one."""
FAKES: Mapping[str, type] = {
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
"""The fake's classes by the names of the real classes that they stand for."""
