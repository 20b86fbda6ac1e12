"""Protocols for CARLA's client library, and everything that is specific to CARLA.

The library is an optional dependency whose versions differ, so protocols describe the
members that are used; no other members may be used, and only attributes of `Settings`
may be set. `load_carla` has the only ``import carla``. This module also has what is
known about CARLA without a simulator: the values that a scenario may use, conversions
to numbers, and the errors.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Final, Protocol, TypeAlias, runtime_checkable

from filter_core.geometry.pose import Transform

WEATHER_PARAMETERS: Final = (
    "cloudiness",
    "precipitation",
    "precipitation_deposits",
    "wind_intensity",
    "sun_azimuth_angle",
    "sun_altitude_angle",
    "fog_density",
    "fog_distance",
    "fog_falloff",
    "wetness",
    "scattering_intensity",
    "mie_scattering_scale",
    "rayleigh_scattering_scale",
    "dust_storm",
)
WEATHER_PRESETS: Final = (
    "Default", "ClearNight", "ClearNoon", "ClearSunset", "CloudyNight", "CloudyNoon",
    "CloudySunset", "DustStorm", "HardRainNight", "HardRainNoon", "HardRainSunset",
    "MidRainSunset", "MidRainyNight", "MidRainyNoon", "SoftRainNight", "SoftRainNoon",
    "SoftRainSunset", "WetCloudyNight", "WetCloudyNoon", "WetCloudySunset", "WetNight",
    "WetNoon", "WetSunset",
)  # fmt: skip
VEHICLE_LIGHTS: Final = (
    "Position", "LowBeam", "HighBeam", "Brake", "RightBlinker", "LeftBlinker",
    "Reverse", "Fog", "Interior", "Special1", "Special2", "All",
)  # fmt: skip
MAP_LAYERS: Final = (
    "Buildings", "Decals", "Foliage", "Ground", "ParkedVehicles", "Particles", "Props",
    "StreetLights", "Walls", "All",
)  # fmt: skip
LENS_ATTRIBUTES: Final = (
    "lens_circle_falloff",
    "lens_circle_multiplier",
    "lens_k",
    "lens_kcube",
    "lens_x_size",
    "lens_y_size",
)
"""Attributes that distort the image; `lens_flare_intensity` only adds light."""

_WRONG_METADATA: Final = ((0, 9, 14), (0, 9, 15))
"""Versions whose images can have the pose of another tick than the one they show."""
_DIGITS: Final = 6


class CaptureError(Exception):
    """A capture cannot begin or continue; the text says why."""


class ScenarioError(CaptureError):
    """A scenario is wrong, or does not fit the simulator; nothing was spawned."""


class SimulatorAway(CaptureError):
    """No simulator answers at the address."""


class Vector(Protocol):
    """`carla.Location` and `carla.Vector3D`: metres."""

    x: float
    y: float
    z: float


class Turn(Protocol):
    """`carla.Rotation`: degrees."""

    pitch: float
    yaw: float
    roll: float


class Pose(Protocol):
    """`carla.Transform`."""

    @property
    def location(self) -> Vector: ...
    @property
    def rotation(self) -> Turn: ...


class Box(Protocol):
    """`carla.BoundingBox`; `extent` are half sizes."""

    @property
    def location(self) -> Vector: ...
    @property
    def extent(self) -> Vector: ...
    @property
    def rotation(self) -> Turn: ...


class AttributeType(Protocol):
    """`carla.ActorAttributeType`, named ``Int``, ``Float``, ``Bool`` and so on."""

    name: str


class Attribute(Protocol):
    """`carla.ActorAttribute`: one setting of a blueprint."""

    id: str

    @property
    def type(self) -> AttributeType: ...
    @property
    def recommended_values(self) -> Sequence[str]: ...
    def as_int(self) -> int: ...
    def as_str(self) -> str: ...


class Blueprint(Protocol):
    """`carla.ActorBlueprint`: what can be spawned, with its attributes."""

    id: str

    def has_attribute(self, name: str, /) -> bool: ...
    def get_attribute(self, name: str, /) -> Attribute: ...
    def set_attribute(self, name: str, value: str, /) -> None: ...
    def __iter__(self) -> Iterator[Attribute]: ...


class BlueprintLibrary(Protocol):
    """`carla.BlueprintLibrary`."""

    def find(self, name: str, /) -> Blueprint: ...
    def filter(self, pattern: str, /) -> BlueprintLibrary: ...
    def __iter__(self) -> Iterator[Blueprint]: ...


class Actor(Protocol):
    """`carla.Actor`: anything that was spawned or that the map placed.

    From 0.9.16 on `bounding_box` asks the simulator, and raises RuntimeError for an
    actor that is gone. Older versions do not have `is_dormant`: see `is_dormant`.
    """

    id: int
    type_id: str

    @property
    def attributes(self) -> Mapping[str, str]: ...
    @property
    def parent(self) -> Actor | None: ...
    @property
    def semantic_tags(self) -> Iterable[int]: ...
    @property
    def bounding_box(self) -> Box: ...
    def get_transform(self) -> Pose: ...


@runtime_checkable
class Vehicle(Protocol):
    """The members of `carla.Vehicle` besides those of all actors."""

    def set_autopilot(self, enabled: bool, port: int, /) -> None: ...
    def set_light_state(self, state: object, /) -> None: ...


@runtime_checkable
class WalkerController(Protocol):
    """The members of `carla.WalkerAIController` besides those of all actors."""

    def start(self) -> None: ...
    def stop(self) -> None: ...
    def go_to_location(self, destination: Vector, /) -> None: ...
    def set_max_speed(self, speed: float, /) -> None: ...


@runtime_checkable
class TrafficLight(Protocol):
    """The members of `carla.TrafficLight` besides those of all actors."""

    def get_light_boxes(self) -> Iterable[Box]: ...


@runtime_checkable
class Sensor(Protocol):
    """The members of `carla.Sensor` besides those of all actors."""

    def listen(self, callback: Callable[[Measurement], None], /) -> None: ...
    def stop(self) -> None: ...


class Measurement(Protocol):
    """`carla.SensorData`: the measurement of a sensor at one tick."""

    frame: int

    @property
    def transform(self) -> Pose: ...


@runtime_checkable
class Image(Protocol):
    """`carla.Image`: pixels of four bytes each, blue, green, red, alpha.

    `raw_data` is a view of memory that lives as long as the image.
    """

    width: int
    height: int

    @property
    def raw_data(self) -> memoryview: ...


@runtime_checkable
class PointCloud(Protocol):
    """A measurement of either kind of LiDAR: rows of 4-byte numbers."""

    @property
    def raw_data(self) -> memoryview: ...


class Detection(Protocol):
    """`carla.RadarDetection`: metres, radians, and metres per second."""

    velocity: float
    azimuth: float
    altitude: float
    depth: float


@runtime_checkable
class RadarScan(Protocol):
    """`carla.RadarMeasurement`."""

    def __iter__(self) -> Iterator[Detection]: ...


class ActorList(Protocol):
    """`carla.ActorList`."""

    def filter(self, pattern: str, /) -> ActorList: ...
    def __iter__(self) -> Iterator[Actor]: ...


class ActorSnapshot(Protocol):
    """`carla.ActorSnapshot`: an actor at one tick."""

    id: int

    def get_transform(self) -> Pose: ...


class Timestamp(Protocol):
    """`carla.Timestamp`."""

    elapsed_seconds: float


class WorldSnapshot(Protocol):
    """`carla.WorldSnapshot`: the poses of all actors at one tick."""

    frame: int

    @property
    def timestamp(self) -> Timestamp: ...
    def find(self, actor_id: int, /) -> ActorSnapshot | None: ...
    def __iter__(self) -> Iterator[ActorSnapshot]: ...


class EnvironmentObject(Protocol):
    """`carla.EnvironmentObject`: a thing of the map, its box in the world."""

    id: int
    name: str

    @property
    def bounding_box(self) -> Box: ...


class Settings(Protocol):
    """`carla.WorldSettings`: a copy, which `World.apply_settings` applies."""

    synchronous_mode: bool
    no_rendering_mode: bool
    fixed_delta_seconds: float | None


class Map(Protocol):
    """`carla.Map`; its name may have folders before it."""

    name: str

    def get_spawn_points(self) -> Iterable[Pose]: ...


class World(Protocol):
    """`carla.World`; each call waits for the simulator, RuntimeError if it is gone.

    Weather, map layers and labels are only passed on, so they are plain objects here.
    """

    def get_settings(self) -> Settings: ...
    def apply_settings(self, settings: Settings, seconds: float = ..., /) -> int: ...
    def tick(self, seconds: float, /) -> int: ...
    def get_snapshot(self) -> WorldSnapshot: ...
    def on_tick(self, callback: Callable[[WorldSnapshot], None], /) -> int: ...
    def remove_on_tick(self, callback_id: int, /) -> None: ...
    def get_map(self) -> Map: ...
    def get_weather(self) -> object: ...
    def set_weather(self, weather: object, /) -> None: ...
    def load_map_layer(self, layer: object, /) -> None: ...
    def unload_map_layer(self, layer: object, /) -> None: ...
    def get_blueprint_library(self) -> BlueprintLibrary: ...
    def spawn_actor(
        self,
        blueprint: Blueprint,
        pose: Pose,
        attach_to: Actor | None,
        attachment: object,
        /,
    ) -> Actor: ...
    def try_spawn_actor(
        self, blueprint: Blueprint, pose: Pose, attach_to: Actor | None = ..., /
    ) -> Actor | None: ...
    def get_actors(self) -> ActorList: ...
    def get_environment_objects(
        self, label: object, /
    ) -> Iterable[EnvironmentObject]: ...
    def get_level_bbs(self, label: object, /) -> Iterable[Box]: ...
    def get_random_location_from_navigation(self) -> Vector | None: ...
    def set_pedestrians_seed(self, seed: int, /) -> None: ...
    def set_pedestrians_cross_factor(self, share: float, /) -> None: ...


@runtime_checkable
class GlassWorld(Protocol):
    """The additional members of worlds from 0.9.16 on."""

    def set_annotations_traverse_translucency(self, enabled: bool, /) -> None: ...


class TrafficManager(Protocol):
    """`carla.TrafficManager`: drives vehicles that are on autopilot."""

    def set_synchronous_mode(self, enabled: bool, /) -> None: ...
    def set_random_device_seed(self, seed: int, /) -> None: ...
    def set_global_distance_to_leading_vehicle(self, metres: float, /) -> None: ...
    def global_percentage_speed_difference(self, percent: float, /) -> None: ...
    def set_respawn_dormant_vehicles(self, enabled: bool, /) -> None: ...
    def set_hybrid_physics_mode(self, enabled: bool, /) -> None: ...
    def set_hybrid_physics_radius(self, metres: float, /) -> None: ...
    def update_vehicle_lights(self, vehicle: Actor, enabled: bool, /) -> None: ...


class Response(Protocol):
    """`carla.command.Response`; `error` is empty if the command was carried out."""

    error: str


class Client(Protocol):
    """`carla.Client`: the connection to a simulator."""

    def set_timeout(self, seconds: float, /) -> None: ...
    def get_server_version(self) -> str: ...
    def get_client_version(self) -> str: ...
    def get_available_maps(self) -> Iterable[str]: ...
    def get_world(self) -> World: ...
    def load_world(self, name: str, /) -> World: ...
    def get_trafficmanager(self, port: int, /) -> TrafficManager: ...
    def apply_batch_sync(
        self, commands: Sequence[object], do_tick: bool, /
    ) -> Iterable[Response]: ...


_Client: TypeAlias = Client


class AttachmentTypes(Protocol):
    """`carla.AttachmentType`."""

    Rigid: object


class Labels(Protocol):
    """`carla.CityObjectLabel`; before 0.9.14 it has one label for all vehicles."""

    TrafficLight: object


class Commands(Protocol):
    """`carla.command`."""

    DestroyActor: Callable[[int], object]


class Carla(Protocol):
    """The module `carla`.

    `VehicleLightState`, `WeatherParameters` and `MapLayer` have an attribute for each
    of the words above.
    """

    Client: Callable[[str, int], _Client]
    Location: Callable[[float, float, float], Vector]
    Rotation: Callable[[float, float, float], Turn]
    Transform: Callable[..., Pose]
    WeatherParameters: Callable[[], object]
    VehicleLightState: Callable[[int], object]
    AttachmentType: AttachmentTypes
    CityObjectLabel: Labels
    MapLayer: object
    command: Commands


def load_carla() -> Carla:
    """The module `carla`, in the installed version.

    Raises `CaptureError`: it is not installed; the text says how to install it.
    """
    try:
        import carla
    except ImportError as error:
        raise CaptureError(
            "capture needs CARLA's client library: pip install 'unghost[carla]', or "
            f"carla in the version of your simulator ({error})"
        ) from error
    library: Carla = carla
    return library


def connect(carla: Carla, host: str, port: int, timeout_s: float) -> Client:
    """A client of the simulator, which has answered once.

    Raises `SimulatorAway`: nothing answers within the time-out.
    """
    try:
        # Raises for a host name without an address.
        client = carla.Client(host, port)
        client.set_timeout(timeout_s)
        client.get_server_version()
    except RuntimeError as error:
        raise SimulatorAway(f"no simulator at {host}:{port}: {error}") from error
    return client


def answers(client: Client, timeout_s: float) -> bool:
    """Whether the simulator answers; sets the time-out of the client for good."""
    client.set_timeout(timeout_s)
    try:
        client.get_server_version()
    except RuntimeError:
        return False
    return True


def as_image(measurement: Measurement) -> Image:
    """The measurement of a camera; `CaptureError` if it is not an image."""
    if not isinstance(measurement, Image):
        raise CaptureError("CARLA's library sent data that is not an image")
    return measurement


def is_dormant(actor: Actor) -> bool:
    """Whether a large map has made the actor dormant, so that it is not rendered."""
    return bool(getattr(actor, "is_dormant", False))


def version_numbers(version: str) -> tuple[int, ...]:
    """``0.9.15-12-gabc`` as ``(0, 9, 15)``."""
    match = re.match(r"\D*(\d+(?:\.\d+)*)", version)
    return tuple(int(part) for part in match[1].split(".")) if match else ()


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
    """A float32 of the library, rounded to the digits that mean something."""
    return round(float(value), _DIGITS)
