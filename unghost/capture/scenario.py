"""A scenario: everything that one capture does, read from one YAML file."""

from __future__ import annotations

import hashlib
import json
import reprlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, get_args

import yaml
from pydantic import BaseModel, Field, ValidationError, model_validator

from filter_core.values import nearest
from unghost.capture.errors import ScenarioError
from unghost.capture.scenario_parts import (
    Boxes,
    Camera,
    ClassName,
    Ego,
    MapLayer,
    Part,
    Port,
    Sensors,
    TrafficManager,
    Vehicles,
    Walkers,
    Weather,
)

_SHORT: Final = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 60
_MAX_BYTES: Final = 1 << 20
_NOT_THE_CONTENT: Final = frozenset({"host", "port", "timeout_s", "frames"})
"""Keys that may differ when a capture goes on: where, how long, how many."""


class Scenario(Part):
    """One capture. Times are simulated seconds, distances metres."""

    host: str = "127.0.0.1"
    port: Port = 2000
    timeout_s: float = Field(default=30.0, ge=1, le=3600)
    map: str | None = None
    map_layers: dict[MapLayer, bool] = Field(default_factory=dict)
    seed: int = Field(default=0, ge=0, le=2**31 - 1)
    delta_s: float = Field(default=0.05, gt=0, le=0.1)
    warm_up_ticks: int = Field(default=20, ge=10, le=10_000)
    interval_s: float = Field(default=1.0, gt=0, le=86_400)
    frames: int = Field(default=100, ge=1, le=10_000_000)
    sensor_wait_s: float = Field(default=10.0, gt=0, le=3600)
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
    def _whole_ticks(self) -> Scenario:
        if self.interval_s < self.delta_s:
            raise ValueError(
                f"interval_s {self.interval_s:g} is shorter than a tick "
                f"(delta_s {self.delta_s:g})"
            )
        return self

    @property
    def ticks_per_frame(self) -> int:
        """Ticks from one recorded frame to the next."""
        return max(1, round(self.interval_s / self.delta_s))

    @property
    def digest(self) -> str:
        """What the recorded frames depend on, as SHA-256."""
        content = self.model_dump(mode="json", exclude=set(_NOT_THE_CONTENT))
        canonical = json.dumps(content, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(canonical.encode()).hexdigest()


def read_scenario(path: Path) -> Scenario:
    """The scenario of a file.

    Raises
    ------
    ScenarioError
        Every fault, with the file, the key, and the nearest valid key.
    """
    content = path.read_bytes()
    if len(content) > _MAX_BYTES:
        raise ScenarioError(f"{path.name}: more than {_MAX_BYTES} bytes")
    return parse_scenario(read_yaml(content, path.name), path.name)


def read_yaml(content: bytes, name: str) -> object:
    """A YAML document; `ScenarioError` names the file and the line."""
    try:
        return _UniqueKeys(content.decode("utf-8-sig")).get_single_data()
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        said = " ".join(str(error).split())
        raise ScenarioError(f"{name}: not YAML: {said[:200]}") from error
    except (ValueError, LookupError, AttributeError) as error:
        # A date that no calendar has, and tags that are written out: `!!int many`.
        raise ScenarioError(f"{name}: not a value: {error}") from error


class _UniqueKeys(yaml.SafeLoader):
    """Refuses a key that stands twice: the first one would be passed over."""

    # The type is that of the stubs; in truth an anchor is a name or None.
    def compose_mapping_node(self, anchor: dict[Any, yaml.Node]) -> yaml.MappingNode:
        node = super().compose_mapping_node(anchor)
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                problem = f"{key.value[:60]!r} stands twice"
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
    place = [one for one in loc if one != "[key]"] if isinstance(loc, tuple) else []
    key = ".".join(str(part) for part in place)
    if fault["type"] == "extra_forbidden":
        valid = valid_keys(place[:-1])
        hint = nearest(str(place[-1]).casefold(), valid)
        return f"{name}: {key}: unknown key; the nearest valid key is {hint!r}"
    said = str(fault["msg"]).removeprefix("Value error, ")
    given = fault["input"]
    found = "" if isinstance(given, Mapping) else f", found {_shown(given)}"
    return f"{name}: {key}: {said}{found}" if key else f"{name}: {said}"


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
    found = (_model_in(inner) for inner in get_args(annotation))
    return next((model for model in found if model is not None), None)


def _shown(value: object) -> str:
    # A few bytes of aliases can stand for a text of gigabytes.
    return _SHORT.repr(value)
