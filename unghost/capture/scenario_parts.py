"""The parts of a scenario: what may stand under each key, and in which range."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal, TypeAlias, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from filter_core.values import nearest
from unghost.capture.carla_words import (
    LENS_ATTRIBUTES,
    MAP_LAYERS,
    VEHICLE_LIGHTS,
    WEATHER_PARAMETERS,
    WEATHER_PRESETS,
)


class Part(BaseModel):
    """A mapping of the scenario: unknown keys and wrong types are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _no_yes_for_a_number(cls, given: object, place: ValidationInfo) -> object:
        # `true` would be taken for 1, and `on` and `yes` are true in YAML.
        kind = cls.model_fields[str(place.field_name)].annotation
        if isinstance(given, bool) and bool not in (kind, *get_args(kind)):
            raise ValueError("true and false mean nothing here")
        return given


def _one_of(word: str, words: tuple[str, ...], what: str) -> str:
    if word not in words:
        raise ValueError(f"unknown {what}; the nearest is {nearest(word, words)!r}")
    return word


def _preset(word: str) -> str:
    return _one_of(word, WEATHER_PRESETS, "preset")


def _parameter(word: str) -> str:
    return _one_of(word, WEATHER_PARAMETERS, "weather parameter")


def _light(word: str) -> str:
    return _one_of(word, VEHICLE_LIGHTS, "light")


def _lens(word: str) -> str:
    return _one_of(word, LENS_ATTRIBUTES, "attribute of the lens")


def _layer(word: str) -> str:
    return _one_of(word, MAP_LAYERS, "map layer")


Preset: TypeAlias = Annotated[str, AfterValidator(_preset)]
WeatherParameter: TypeAlias = Annotated[str, AfterValidator(_parameter)]
VehicleLight: TypeAlias = Annotated[str, AfterValidator(_light)]
LensAttribute: TypeAlias = Annotated[str, AfterValidator(_lens)]
MapLayer: TypeAlias = Annotated[str, AfterValidator(_layer)]
Port: TypeAlias = Annotated[int, Field(ge=1, le=65535)]
Count: TypeAlias = Annotated[int, Field(ge=0, le=2000)]
Generation: TypeAlias = Literal[1, 2, "all"]
Wheels: TypeAlias = Literal[2, 4, "all"]
AttributeValue: TypeAlias = bool | int | float | str


class TrafficManager(Part):
    """How CARLA's traffic manager drives the vehicles."""

    port: Port = 8000
    hybrid_physics: bool = False
    hybrid_radius: float = Field(default=70.0, gt=0)
    distance_to_leading_vehicle: float = Field(default=2.5, ge=0)
    slower_than_limit_percent: float = Field(default=30.0, le=100)
    respawn_dormant: bool = False


class Vehicles(Part):
    """The vehicles beside the ego vehicle."""

    count: Count = 0
    filter: str = "vehicle.*"
    wheels: Wheels = "all"
    generation: Generation = "all"
    safe: bool = False
    lights: tuple[VehicleLight, ...] = ()
    automatic_lights: bool = False


class Walkers(Part):
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
        """All of them."""
        return self.standing + self.walking + self.running


class Sweep(Part):
    """One weather parameter that changes evenly from the first frame to the last."""

    first: float
    last: float


class Weather(Part):
    """A preset, parameters on top of it, and how it changes from frame to frame."""

    preset: Preset | None = None
    parameters: dict[WeatherParameter, float] = Field(default_factory=dict)
    presets: tuple[Preset, ...] = ()
    frames_per_preset: int = Field(default=1, ge=1)
    sweep: dict[WeatherParameter, Sweep] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _one_meaning(self) -> Weather:
        if self.preset is not None and self.presets:
            raise ValueError("preset and presets exclude each other")
        both = sorted(set(self.parameters) & set(self.sweep))
        if both:
            raise ValueError(f"{both[0]} stands in parameters and in sweep")
        return self

    @property
    def is_given(self) -> bool:
        """Whether the simulator's own weather is to be changed at all."""
        chosen = (self.preset, self.parameters, self.presets, self.sweep)
        return any(bool(value) for value in chosen)


class Ego(Part):
    """The vehicle that carries the sensors."""

    blueprint: str = "vehicle.lincoln.mkz_2020"
    spawn_point: int | None = Field(default=None, ge=0)
    role_name: str = "hero"
    autopilot: bool = True
    lights: tuple[VehicleLight, ...] = ()


class Mount(Part):
    """Where a sensor sits on the ego vehicle, metres and degrees."""

    x: float = 1.5
    y: float = 0.0
    z: float = 2.4
    pitch: float = 0.0
    yaw: float = 0.0
    roll: float = 0.0


class Camera(Part):
    """What all cameras share: they must see the same, pixel by pixel."""

    width: int = Field(default=1280, ge=16, le=16384)
    height: int = Field(default=720, ge=16, le=16384)
    fov: float = Field(default=90.0, gt=0, lt=180)
    mount: Mount = Mount()
    lens: dict[LensAttribute, AttributeValue] = Field(default_factory=dict)


class CameraSensor(Part):
    """One camera: which, and attributes that are its own."""

    attributes: dict[str, AttributeValue] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _nothing_shared(self) -> CameraSensor:
        shared = {"image_size_x", "image_size_y", "fov", "sensor_tick"}
        for name in self.attributes:
            if name in shared or name in LENS_ATTRIBUTES:
                raise ValueError(
                    f"attributes.{name} is the same for all cameras: see the key camera"
                    if name != "sensor_tick"
                    else "attributes.sensor_tick must stay 0: see interval_s"
                )
        return self


class RangeSensor(Part):
    """A LiDAR or a radar: where it sits, and any attribute of its blueprint."""

    mount: Mount = Mount()
    attributes: dict[str, AttributeValue] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _every_tick(self) -> RangeSensor:
        if "sensor_tick" in self.attributes:
            raise ValueError("attributes.sensor_tick must stay 0: see interval_s")
        return self


class Sensors(Part):
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
    def _yes_and_no(cls, given: object) -> object:
        if not isinstance(given, Mapping):
            return given
        plain: dict[object, object] = {True: {}, False: None}
        return {
            name: plain[value] if isinstance(value, bool) else value
            for name, value in given.items()
        }

    @model_validator(mode="after")
    def _one_camera(self) -> Sensors:
        if not (self.rgb or self.segmentation):
            raise ValueError("a frame needs rgb or segmentation")
        return self


class Boxes(Part):
    """Which objects get boxes, and how CARLA's known defects are met."""

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
    def _in_order(self) -> Boxes:
        if self.min_distance >= self.max_distance:
            raise ValueError("min_distance must be below max_distance")
        if list(self.bands) != sorted({*self.bands}) or any(b <= 0 for b in self.bands):
            raise ValueError("bands must rise from above 0")
        return self


ClassName: TypeAlias = Annotated[str, Field(min_length=1, max_length=64)]
