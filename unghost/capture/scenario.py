"""A scenario: the description of a capture, read from one YAML file.

Each class is a mapping of that file: the keys that may stand in it, their ranges and
their defaults, which docs/capture.md explains to users. `read_scenario` names every
fault of a file at once, each with its key and the nearest one that is valid.
"""

from __future__ import annotations

import hashlib
import json
import math
import reprlib
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Annotated, Final, Literal, TypeAlias, get_args

import yaml
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from filter_core.values import nearest
from unghost.capture.simulator import (
    LENS_ATTRIBUTES,
    MAP_LAYERS,
    VEHICLE_LIGHTS,
    WEATHER_PARAMETERS,
    WEATHER_PRESETS,
    ScenarioError,
)

_SHORT: Final = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 60
_MAX_BYTES: Final = 1 << 20
_MAX_WRITTEN: Final = 2 * _MAX_BYTES
"""Characters and values of a document, with all that its aliases stand for."""
_NOT_THE_CONTENT: Final = frozenset({"host", "port", "timeout_s", "frames"})
"""Keys that, like `sensor_wait_s`, may differ when a capture is continued."""
_USUAL_SENSOR_WAIT_S: Final = 10.0
Port: TypeAlias = Annotated[int, Field(ge=1, le=65535)]
Count: TypeAlias = Annotated[int, Field(ge=0, le=2000)]
Generation: TypeAlias = Literal[1, 2, "all"]
Wheels: TypeAlias = Literal[2, 4, "all"]
AttributeValue: TypeAlias = bool | int | float | str
ClassName: TypeAlias = Annotated[str, Field(min_length=1, max_length=64)]


def _one_of(words: tuple[str, ...], what: str) -> AfterValidator:
    """A validator of texts that have to be one of these words; names the nearest."""

    def check(word: str) -> str:
        if word not in words:
            raise ValueError(f"unknown {what}; the nearest is {nearest(word, words)!r}")
        return word

    return AfterValidator(check)


MapLayer: TypeAlias = Annotated[str, _one_of(MAP_LAYERS, "map layer")]
VehicleLight: TypeAlias = Annotated[str, _one_of(VEHICLE_LIGHTS, "light")]
Preset: TypeAlias = Annotated[str, _one_of(WEATHER_PRESETS, "preset")]
WeatherParameter: TypeAlias = Annotated[
    str, _one_of(WEATHER_PARAMETERS, "weather parameter")
]
LensAttribute: TypeAlias = Annotated[
    str, _one_of(LENS_ATTRIBUTES, "attribute of the lens")
]


class ScenarioSection(BaseModel):
    """A mapping of the scenario: unknown keys and wrong types are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _refuse_bool_as_number(cls, entry: object, place: ValidationInfo) -> object:
        # `true` would be taken for 1, and `on` and `yes` are true in YAML.
        kind = cls.model_fields[str(place.field_name)].annotation
        if _may_be_bool(kind):
            return entry
        inner: list[object] = []
        if isinstance(entry, list | tuple):
            inner = [*entry]
        elif isinstance(entry, Mapping) and _model_in(kind) is None:
            inner = [*entry.values()]  # those of a model check themselves
        if any(isinstance(value, bool) for value in (entry, *inner)):
            raise ValueError("true and false are not allowed here")
        return entry


def _may_be_bool(annotation: object) -> bool:
    """Whether a value of this type, or one in it, may be true or false."""
    return annotation is bool or any(map(_may_be_bool, get_args(annotation)))


class TrafficManager(ScenarioSection):
    """How CARLA's traffic manager drives the vehicles."""

    port: Port = 8000
    hybrid_physics: bool = False
    hybrid_radius: float = Field(default=70.0, gt=0)
    distance_to_leading_vehicle: float = Field(default=2.5, ge=0)
    slower_than_limit_percent: float = Field(default=30.0, le=100)
    respawn_dormant: bool = False


class Vehicles(ScenarioSection):
    """The vehicles other than the ego vehicle."""

    count: Count = 0
    filter: str = "vehicle.*"
    wheels: Wheels = "all"
    generation: Generation = "all"
    safe: bool = False
    exclude: tuple[str, ...] = ()
    lights: tuple[VehicleLight, ...] = ()
    automatic_lights: bool = False


class Walkers(ScenarioSection):
    """People on foot."""

    standing: Count = 0
    walking: Count = 0
    running: Count = 0
    filter: str = "walker.pedestrian.*"
    generation: Generation = "all"
    cross_percent: float = Field(default=0.0, ge=0, le=100)
    seed: int | None = Field(default=None, ge=0, le=2**31 - 1)

    @property
    def count(self) -> int:
        """The number of pedestrians: standing, walking and running."""
        return self.standing + self.walking + self.running


class Sweep(ScenarioSection):
    """One weather parameter that changes evenly from the first frame to the last."""

    first: float
    last: float


class Weather(ScenarioSection):
    """A preset, parameters on top of it, and how it changes from frame to frame."""

    preset: Preset | None = None
    parameters: dict[WeatherParameter, float] = Field(default_factory=dict)
    presets: tuple[Preset, ...] = ()
    frames_per_preset: int = Field(default=1, ge=1)
    sweep: dict[WeatherParameter, Sweep] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check_exclusive_keys(self) -> Weather:
        if self.preset is not None and self.presets:
            raise ValueError("preset and presets cannot be given together")
        both = sorted(set(self.parameters) & set(self.sweep))
        if both:
            raise ValueError(f"{both[0]} is in both parameters and sweep")
        return self

    @property
    def is_given(self) -> bool:
        """Whether the scenario changes the simulator's weather."""
        chosen = (self.preset, self.parameters, self.presets, self.sweep)
        return any(bool(value) for value in chosen)


class Ego(ScenarioSection):
    """The vehicle that carries the sensors."""

    blueprint: str = "vehicle.lincoln.mkz_2020"
    spawn_point: int | None = Field(default=None, ge=0)
    role_name: str = "hero"
    autopilot: bool = True
    lights: tuple[VehicleLight, ...] = ()


class Mount(ScenarioSection):
    """Where a sensor sits on the ego vehicle, metres and degrees."""

    x: float = 1.5
    y: float = 0.0
    z: float = 2.4
    pitch: float = 0.0
    yaw: float = 0.0
    roll: float = 0.0


class Camera(ScenarioSection):
    """The settings of all cameras, whose images must match pixel by pixel."""

    width: int = Field(default=1280, ge=16, le=16384)
    height: int = Field(default=720, ge=16, le=16384)
    fov: float = Field(default=90.0, gt=0, lt=180)
    mount: Mount = Mount()
    lens: dict[LensAttribute, AttributeValue] = Field(default_factory=dict)


class CameraSensor(ScenarioSection):
    """One camera, and its own attributes."""

    attributes: dict[str, AttributeValue] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _refuse_shared_attributes(self) -> CameraSensor:
        shared = {"image_size_x", "image_size_y", "fov", "sensor_tick"}
        for name in self.attributes:
            if name in shared or name in LENS_ATTRIBUTES:
                raise ValueError(
                    f"attributes.{name} is the same for all cameras: set it in camera"
                    if name != "sensor_tick"
                    else "attributes.sensor_tick must stay 0: see interval_s"
                )
        return self


class RangeSensor(ScenarioSection):
    """A LiDAR or a radar: where it sits, and any attribute of its blueprint."""

    mount: Mount = Mount()
    attributes: dict[str, AttributeValue] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _refuse_sensor_tick(self) -> RangeSensor:
        if "sensor_tick" in self.attributes:
            raise ValueError("attributes.sensor_tick must stay 0: see interval_s")
        return self


class Sensors(ScenarioSection):
    """Which sensors are recorded: true, false, or what differs from the defaults."""

    rgb: CameraSensor | None = CameraSensor()
    segmentation: CameraSensor | None = CameraSensor()
    instances: CameraSensor | None = None
    depth: CameraSensor | None = None
    lidar: RangeSensor | None = None
    semantic_lidar: RangeSensor | None = None
    radar: RangeSensor | None = None

    @model_validator(mode="before")
    @classmethod
    def _expand_bools(cls, entries: object) -> object:
        if not isinstance(entries, Mapping):
            return entries
        plain: dict[object, object] = {True: {}, False: None}
        return {
            name: plain[value] if isinstance(value, bool) else value
            for name, value in entries.items()
        }

    @model_validator(mode="after")
    def _require_camera(self) -> Sensors:
        if not (self.rgb or self.segmentation):
            raise ValueError("a frame needs rgb or segmentation")
        return self


class Boxes(ScenarioSection):
    """Which objects get boxes, and how CARLA's known errors are corrected."""

    vehicles: bool = True
    walkers: bool = True
    parked_vehicles: bool = True
    traffic_lights: bool = True
    min_distance: float = Field(default=0.0, ge=0)
    max_distance: float = Field(default=200.0, gt=0)
    bands: tuple[float, ...] = (50, 100, 150, 200)
    repair_two_wheelers: bool = True
    widen_walkers_m: float = Field(default=0.15, ge=0, le=1)

    @model_validator(mode="after")
    def _check_distances(self) -> Boxes:
        if self.min_distance >= self.max_distance:
            raise ValueError("min_distance must be below max_distance")
        if list(self.bands) != sorted({*self.bands}) or any(b <= 0 for b in self.bands):
            raise ValueError("bands must rise from above 0")
        return self


class Scenario(ScenarioSection):
    """One capture. Times are simulated seconds, distances metres."""

    host: str = "127.0.0.1"
    port: Port = 2000
    timeout_s: float = Field(default=30.0, ge=1, le=3600)
    map: str | None = None
    maps: tuple[str, ...] = ()
    map_layers: dict[MapLayer, bool] = Field(default_factory=dict)
    seed: int = Field(default=0, ge=0, le=2**31 - 1)
    delta_s: float = Field(default=0.05, gt=0, le=0.1)
    warm_up_ticks: int = Field(default=20, ge=10, le=10_000)
    interval_s: float = Field(default=1.0, gt=0, le=86_400)
    frames: int = Field(default=100, ge=1, le=10_000_000)
    sensor_wait_s: float = Field(default=_USUAL_SENSOR_WAIT_S, gt=0, le=3600)
    see_through_glass: bool | None = None
    traffic_manager: TrafficManager = TrafficManager()
    vehicles: Vehicles = Vehicles()
    walkers: Walkers = Walkers()
    weather: Weather = Weather()
    ego: Ego = Ego()
    camera: Camera = Camera()
    sensors: Sensors = Sensors()
    boxes: Boxes = Boxes()
    classes: dict[str, ClassName] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check_interval(self) -> Scenario:
        if self.interval_s < self.delta_s:
            raise ValueError(
                f"interval_s {self.interval_s:g} is shorter than a tick "
                f"(delta_s {self.delta_s:g})"
            )
        return self

    @model_validator(mode="after")
    def _check_maps(self) -> Scenario:
        if self.maps and self.map is not None:
            raise ValueError("map and maps cannot be given together")
        names = [short_name(name) for name in self.maps]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise ValueError(f"maps: {twice[0]!r} occurs twice")
        return self

    @property
    def of_each_map(self) -> tuple[Scenario, ...]:
        """A scenario for each of `maps`, in their order; without them, this one."""
        if not self.maps:
            return (self,)
        update = ({"map": name, "maps": ()} for name in self.maps)
        return tuple(self.model_copy(update=changes) for changes in update)

    @property
    def all_frames(self) -> int:
        """The frames of all maps; `frames` are those of each."""
        return self.frames * max(1, len(self.maps))

    @property
    def ticks_per_frame(self) -> int:
        """Ticks from one recorded frame to the next: `interval_s`, rounded."""
        return max(1, round(self.interval_s / self.delta_s))

    @property
    def rounding(self) -> str | None:
        """In words, what `interval_s` becomes if it is not a whole number of ticks."""
        seconds = self.ticks_per_frame * self.delta_s
        if math.isclose(seconds, self.interval_s, rel_tol=1e-6):
            return None
        return (
            f"interval_s {self.interval_s:g} is not a whole number of ticks "
            f"(delta_s {self.delta_s:g}): frames are {seconds:g} s apart"
        )

    @property
    def digest(self) -> str:
        """SHA-256 of the keys on which the recorded frames depend."""
        content = self.model_dump(mode="json", exclude=set(_NOT_THE_CONTENT))
        # Not excluded: a capture that an earlier version began must keep its digest.
        content["sensor_wait_s"] = _USUAL_SENSOR_WAIT_S
        if not self.maps:
            del content["maps"]
        if not self.vehicles.exclude:
            del content["vehicles"]["exclude"]
        canonical = json.dumps(content, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(canonical.encode()).hexdigest()


def short_name(map_name: str) -> str:
    """A map without its folders: ``Town10HD``."""
    return map_name.rsplit("/", 1)[-1]


def read_scenario(path: Path) -> Scenario:
    """The scenario of a file.

    Raises `ScenarioError`: every fault, with the file, the key, and the nearest valid
    key.
    """
    return parse_scenario(read_yaml(path.read_bytes(), path.name), path.name)


def read_yaml(content: bytes, name: str) -> object:
    """A YAML document; `ScenarioError` names the file and the line."""
    if len(content) > _MAX_BYTES:
        raise ScenarioError(f"{name}: larger than {_MAX_BYTES} bytes")
    try:
        document = _UniqueKeys(content.decode("utf-8-sig")).get_single_data()
        size = _written_size(document, {})
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        message = " ".join(str(error).split())
        raise ScenarioError(
            f"{name}: cannot be read as YAML: {message[:200]}"
        ) from error
    except (ValueError, LookupError, AttributeError) as error:
        # A date that no calendar has, and tags that are written out: `!!int many`.
        raise ScenarioError(f"{name}: a value cannot be read: {error}") from error
    if size > _MAX_WRITTEN:
        raise ScenarioError(
            f"{name}: aliases that stand for more than {_MAX_WRITTEN} characters"
        )
    return document


def _written_size(value: object, sizes: dict[int, float]) -> float:
    """Characters and values of a value; infinite if it is within itself.

    `sizes` are those of lists and mappings that were counted already, by their
    identities, since a few bytes of aliases can stand for gigabytes.
    """
    if not isinstance(value, list | tuple | dict):
        return 1 + len(str(value))
    if id(value) not in sizes:
        sizes[id(value)] = math.inf
        inner = chain.from_iterable(value.items()) if isinstance(value, dict) else value
        sizes[id(value)] = 1 + sum(_written_size(part, sizes) for part in inner)
    return sizes[id(value)]


class _UniqueKeys(yaml.SafeLoader):
    """Refuses a key that occurs twice: YAML would ignore the first one."""

    def compose_mapping_node(self, anchor: dict[object, yaml.Node]) -> yaml.MappingNode:
        node = super().compose_mapping_node(anchor)
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                problem = f"{key.value[:60]!r} occurs twice"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
            seen.add(str(key.value))
        return node


def parse_scenario(document: object, name: str) -> Scenario:
    """A scenario from what its YAML says; `name` is that of the file."""
    if document is None:
        document = {}
    if not isinstance(document, Mapping):
        raise ScenarioError(f"{name}: expected keys and values, found neither")
    try:
        return Scenario.model_validate(document)
    except ValidationError as error:
        faults = [_words(fault, name) for fault in error.errors(include_url=False)]
        raise ScenarioError("\n".join(dict.fromkeys(faults))) from error


def _words(fault: Mapping[str, object], name: str) -> str:
    loc = fault["loc"]
    place = [part for part in loc if part != "[key]"] if isinstance(loc, tuple) else []
    key = ".".join(str(part) for part in place)
    if fault["type"] == "extra_forbidden":
        valid = valid_keys(place[:-1])
        hint = nearest(str(place[-1]).casefold(), valid)
        return f"{name}: {key}: unknown key; the nearest valid key is {hint!r}"
    message = str(fault["msg"]).removeprefix("Value error, ")
    value = fault["input"]
    # Not all of it: a few bytes of aliases can stand for a text of gigabytes.
    shown = "" if isinstance(value, Mapping) else f", found {_SHORT.repr(value)}"
    return f"{name}: {key}: {message}{shown}" if key else f"{name}: {message}"


def valid_keys(place: Sequence[object]) -> tuple[str, ...]:
    """The keys that may stand at a place of a scenario."""
    model: type[BaseModel] = Scenario
    for part in place:
        field = model.model_fields.get(str(part))
        inner = None if field is None else _model_in(field.annotation)
        if inner is None:
            return tuple(model.model_fields)
        model = inner
    return tuple(model.model_fields)


def _model_in(annotation: object) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    models = (_model_in(inner) for inner in get_args(annotation))
    return next((model for model in models if model is not None), None)
