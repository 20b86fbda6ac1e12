"""Converts the seven YAML files of the program carlasimu to one scenario.

Every key is either converted, listed in a note, or refused: none is ignored silently.
Each file is converted and checked separately, so that an error names its file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Final, TypeAlias

import yaml
from pydantic import TypeAdapter, ValidationError

from filter_core.class_names import class_of
from filter_core.config.file import CARLASIMU_ROOT
from filter_core.values import nearest
from unghost.capture.scenario import parse_scenario, read_yaml
from unghost.capture.simulator import (
    LENS_ATTRIBUTES,
    MAP_LAYERS,
    VEHICLE_LIGHTS,
    ScenarioError,
)

_Keys: TypeAlias = Mapping[str, object]
"""The keys of one of its files, or of a part of one."""
_Scenario: TypeAlias = dict[str, object]
"""The keys of a scenario, as `parse_scenario` takes them."""

_LAYERS: Final = {"building": "Buildings"}
"""Layers that have another name in mapLayer.yaml than in CARLA."""
# Keys of data.yaml, and where their values belong.
_PLAIN: Final = {
    "host": "host",
    "port": "port",
    "set_timeout": "timeout_s",
    "fixed_delta_seconds": "delta_s",
    "seed": "seed",
}
_MANAGER: Final = {
    "tm_port": "port",
    "hybrid": "hybrid_physics",
    "physics_radius": "hybrid_radius",
    "global_distance_to_leading_vehicle": "distance_to_leading_vehicle",
    "respawn": "respawn_dormant",
}
_VEHICLES: Final = {
    "number_of_vehicles": "count",
    "filterv": "filter",
    "car_lights_on": "automatic_lights",
}
_WALKERS: Final = {"filterw": "filter", "seedw": "seed"}
_GAITS: Final = {"stand": "standing", "walk": "walking", "run": "running"}
_UNSAFE: Final = ("*carlacola", "*firetruck")
"""The blueprints that its `safe` leaves out (`blueprints_safe` in its code)."""
_WITHOUT_MEANING: Final = ("apply_settings", "hero", "physics_mode", "wait_for_tick")
_DATA_KEYS: Final = frozenset(
    {
        *_PLAIN, *_MANAGER, *_VEHICLES, *_WALKERS, *_WITHOUT_MEANING,
        "safe", "number_of_wheels", "generationv", "generationw", "number_of_walkers",
        "light_state", "asynch", "synchronous", "no_rendering",
    }
)  # fmt: skip
# Keys of boundingBox.yaml.
_RECORDED: Final = {
    "cam_rgb": ("rgb", True),
    "image_segmentation": ("segmentation", True),
    "depth_image_sensor": ("depth", False),
    "lidar_sensor": ("lidar", False),
    "radar_sensor": ("radar", False),
}
"""The sensor that a part is about, and whether it is recorded by default."""
_BOX_KEYS: Final = frozenset(
    {
        *_RECORDED, "fiter_boundinbox", "threshold_small_box", "size_big_box",
        "threshold_big_box", "time_screen_shot",
    }
)  # fmt: skip
_BOX_DISTANCES: Final = ("min_distance", "max_distance")
_BOX_ACTORS: Final = {"vehicles": "vehicles", "walkers": "walkers"}
_UNUSED_OF_PARTS: Final = ("save_dir", "figure_in_window")
_UNUSED_OF_CAMERA: Final = (*_UNUSED_OF_PARTS, "bbox_dir", "path_save", "3D")
_PART_KEYS: Final = frozenset({"save_to_file", *_UNUSED_OF_PARTS})
_CAMERA_KEYS: Final = _PART_KEYS.union(
    _UNUSED_OF_CAMERA, _BOX_DISTANCES, ("filter", "actors", "num_image")
)
# Keys of sensors.yaml.
_NAMES: Final = {
    "rgb_camera": "rgb",
    "semantic_segmentation_camera": "segmentation",
    "depth_camera": "depth",
    "lidar_sensor": "lidar",
    "semantic_lidar": "semantic_lidar",
    "radar_sensor": "radar",
}
_CAMERAS: Final = ("rgb_camera", "semantic_segmentation_camera", "depth_camera")
_SHARED: Final = {"image_size_x": "width", "image_size_y": "height", "fov": "fov"}
_NOT_ATTRIBUTES: Final = frozenset({"location", "sensor_tick"})
_TRUTH: Final[TypeAdapter[bool]] = TypeAdapter(bool)


class _Plain(yaml.SafeDumper):
    """Writes a value that two keys share twice, not as an alias."""

    def ignore_aliases(self, data: object) -> bool:
        return True


def scenario_text(scenario: _Keys, notes: Iterable[str]) -> str:
    """A scenario file: the notes as comments, then the scenario."""
    comments = "".join(f"# {note}\n" for note in notes)
    return comments + yaml.dump(scenario, Dumper=_Plain, sort_keys=False)


def convert_carlasimu(folder: Path) -> tuple[_Scenario, list[str]]:
    """The scenario of carlasimu's folder `yaml_files`; absent files mean defaults.

    It is valid. Keys that were not set, or that have their default, are left out of it.
    With it come notes about keys that were not converted.

    Raises `ScenarioError`: no such file at all, an unknown key (names the nearest), or
    a wrong value.
    """
    there = [name for name in _CONVERTERS if (folder / name).is_file()]
    if not there:
        raise ScenarioError(
            f"{folder}: expected at least one of {', '.join(_CONVERTERS)}, found none"
        )
    contents = {}
    for name in there:
        document = read_yaml((folder / name).read_bytes(), name)
        inner = document.get(CARLASIMU_ROOT) if isinstance(document, Mapping) else None
        if not isinstance(inner, Mapping):
            raise ScenarioError(f"{name}: expected keys under {CARLASIMU_ROOT!r}")
        _refuse_unknown(_mapping(document, name), frozenset({CARLASIMU_ROOT}), name)
        contents[name] = _mapping(inner, name)
    scenario: _Scenario = {}
    notes: list[str] = []
    for name, content in contents.items():
        _CONVERTERS[name](content, scenario, notes)
        parse_scenario(scenario, name)
    return scenario, notes


def _data(content: _Keys, scenario: _Scenario, notes: list[str]) -> None:
    _refuse_unknown(content, _DATA_KEYS, "data.yaml")
    scenario.update(_taken(content, _PLAIN))
    scenario["traffic_manager"] = _taken(content, _MANAGER)
    vehicles = _taken(content, _VEHICLES)
    if _truth(content, "safe", "data.yaml", default=False):
        vehicles["exclude"] = list(_UNSAFE)
    for name, key in (("number_of_wheels", "wheels"), ("generationv", "generation")):
        if name in content:
            vehicles[key] = _number_or_all(content[name])
    lights = _mapping(content.get("light_state"), "data.yaml: light_state")
    # It sets the lights of all vehicles, the ego vehicle's too.
    vehicles["lights"] = _lights(lights)
    scenario["vehicles"] = vehicles
    scenario["ego"] = {"lights": vehicles["lights"]}
    walkers = _taken(content, _WALKERS)
    if "generationw" in content:
        walkers["generation"] = _number_or_all(content["generationw"])
    at = "data.yaml: number_of_walkers"
    counts = _mapping(content.get("number_of_walkers"), at)
    _refuse_unknown(counts, frozenset(_GAITS), at)
    scenario["walkers"] = {**walkers, **_taken(counts, _GAITS)}
    _note_unused(_WITHOUT_MEANING, [content], "data.yaml", notes)
    is_asynchronous = _truth(content, "asynch", "data.yaml", default=False)
    if is_asynchronous or not _truth(content, "synchronous", "data.yaml", default=True):
        notes.append(
            "asynch and synchronous are not used: capture is always synchronous"
        )
    if _truth(content, "no_rendering", "data.yaml", default=False):
        notes.append("no_rendering is not used: cameras need rendering")


def _lights(states: _Keys) -> list[str]:
    lights = {name.casefold(): name for name in VEHICLE_LIGHTS}
    on = set()
    for name in states:
        if name.casefold() not in lights:
            raise ScenarioError(
                f"data.yaml: light_state.{name}: unknown light; the nearest is "
                f"{nearest(name, VEHICLE_LIGHTS)!r}"
            )
        if _truth(states, name, "data.yaml: light_state", default=False):
            on.add(name.casefold())
    return [name for key, name in lights.items() if key in on]


def _number_or_all(value: object) -> object:
    text = str(value).casefold()
    return int(text) if text.isdecimal() else text


def _sensors(content: _Keys, scenario: _Scenario, notes: list[str]) -> None:
    # `camera` and `sensors` of a scenario, from the content of sensors.yaml
    _refuse_unknown(content, frozenset(_NAMES), "sensors.yaml")
    sensors = {
        name: _set(_mapping(settings, f"sensors.yaml: {name}"))
        for name, settings in content.items()
    }
    nothing: _Keys = {}
    first = next((sensors[name] for name in _CAMERAS if name in sensors), nothing)
    lens = _lens(first)
    for name in _CAMERAS:
        other = sensors.get(name)
        if other is not None and _geometry(other) != _geometry(first):
            notes.append(
                f"sensors.yaml: {name} differs from the other cameras; all cameras "
                "of a scenario share one size, place and lens"
            )
    camera = {ours: first[name] for name, ours in _SHARED.items() if name in first}
    camera |= {"mount": mount} if (mount := _mount(first, "camera")) else {}
    camera |= {"lens": lens} if lens else {}
    scenario.update(
        {
            "camera": camera,
            "sensors": {
                _NAMES[name]: _sensor(name, settings, notes)
                for name, settings in sensors.items()
            },
        }
    )


def _geometry(camera: _Keys) -> tuple[object, ...]:
    sizes = tuple(camera.get(name) for name in _SHARED)
    return (*sizes, camera.get("location"), _lens(camera))


def _lens(camera: _Keys) -> dict[str, object]:
    return {name: value for name, value in camera.items() if name in LENS_ATTRIBUTES}


def _mount(sensor: _Keys, name: str) -> dict[str, float]:
    location = sensor.get("location")
    if location is None:
        return {}
    at = f"sensors.yaml: {name}.location"
    if not isinstance(location, list) or len(location) != 2:
        raise ScenarioError(f"{at}: expected x and z")
    return {"x": _number(location[0], at), "z": _number(location[1], at)}


def _sensor(name: str, sensor: _Keys, notes: list[str]) -> dict[str, object]:
    if sensor.get("sensor_tick"):
        notes.append(
            f"sensors.yaml: {name}.sensor_tick is not used: it drifts against the "
            "world's ticks; interval_s says when a frame is recorded"
        )
    shared = {*_SHARED, *_lens(sensor)} if name in _CAMERAS else set()
    attributes = {
        key: value
        for key, value in sensor.items()
        if key not in _NOT_ATTRIBUTES and key not in shared
    }
    if name in _CAMERAS:
        return {"attributes": attributes}
    mount = _mount(sensor, name)
    return {**({"mount": mount} if mount else {}), "attributes": attributes}


def _weather(content: _Keys, scenario: _Scenario, notes: list[str]) -> None:
    numbers = {
        name: _number(value, f"weather.yaml: {name}")
        for name, value in _set(content).items()
    }
    scenario["weather"] = {"parameters": numbers}


def _map_layers(content: _Keys, scenario: _Scenario, notes: list[str]) -> None:
    layers = {**{name: name for name in MAP_LAYERS}, **_LAYERS}
    _refuse_unknown(content, frozenset(layers), "mapLayer.yaml")
    # A layer that is loaded already need not be loaded.
    off = {
        layers[name]: False
        for name in content
        if not _truth(content, name, "mapLayer.yaml", default=True)
    }
    scenario["map_layers"] = off


def _boxes(content: _Keys, scenario: _Scenario, notes: list[str]) -> None:
    _refuse_unknown(content, _BOX_KEYS, "boundingBox.yaml")
    parts = {
        name: _mapping(content.get(name), f"boundingBox.yaml: {name}")
        for name in _RECORDED
    }
    for name, part in parts.items():
        keys = _CAMERA_KEYS if name == "cam_rgb" else _PART_KEYS
        _refuse_unknown(part, keys, f"boundingBox.yaml: {name}")
    camera = parts["cam_rgb"]
    at = "boundingBox.yaml: cam_rgb.actors"
    actors = _mapping(camera.get("actors"), at)
    _refuse_unknown(actors, frozenset(_BOX_ACTORS), at)
    # It labels every traffic light, and boxes are as CARLA has them.
    scenario["boxes"] = {
        **_taken(actors, _BOX_ACTORS),
        "parked_vehicles": False,
        "widen_walkers_m": 0.0,
    }
    scenario.update(_taken(camera, {"num_image": "frames"}))
    scenario.update(_taken(content, {"time_screen_shot": "interval_s"}))
    unwanted = [
        name
        for part, (name, default) in _RECORDED.items()
        if not _truth(
            parts[part], "save_to_file", f"boundingBox.yaml: {part}", default=default
        )
    ]
    if "segmentation" in unwanted:
        unwanted.remove("segmentation")
        notes.append(
            "boundingBox.yaml: the segmentation is recorded all the same: "
            "the filter needs it"
        )
    sensors = _mapping(scenario.get("sensors"), "sensors")
    if "semantic_lidar" in sensors:
        notes.append(
            "sensors.yaml: semantic_lidar is not recorded: carlasimu does not save it"
        )
    scenario["sensors"] = {
        **sensors,
        **dict.fromkeys([*unwanted, "semantic_lidar"], False),
    }
    _note_unused(_UNUSED_OF_CAMERA, parts.values(), "boundingBox.yaml", notes)
    if not set(_BOX_DISTANCES).isdisjoint(camera):
        notes.append(
            "boundingBox.yaml: max_distance limits what carlasimu draws, and "
            "min_distance is applied by the filter: boxes are recorded to 200 m, as "
            "carlasimu's labels are"
        )
    notes.append(
        "filter, min_distance and the thresholds of boundingBox.yaml belong to the "
        "filter: unghost filter --config boundingBox.yaml reads them"
    )


def _vehicles(content: _Keys, scenario: _Scenario, notes: list[str]) -> None:
    named: dict[str, str] = {}
    for name, blueprints in content.items():
        if not isinstance(blueprints, list | None):
            raise _wrong(f"vehicles_name.yaml: {name}", "a list", blueprints)
        for blueprint in map(str, blueprints or ()):
            other = named.setdefault(blueprint, name)
            if other != name:
                raise ScenarioError(
                    f"vehicles_name.yaml: {blueprint} is in both {other} and {name}"
                )
    own = {
        blueprint: name
        for blueprint, name in named.items()
        if class_of(blueprint, None) != name
    }
    if own:
        scenario["classes"] = own


def _colors(content: _Keys, scenario: _Scenario, notes: list[str]) -> None:
    notes.append(
        f"color_segmentation.yaml is not needed: tags are stored as numbers "
        f"({len(content)} colours left behind)"
    )


def _taken(entries: _Keys, names: Mapping[str, str]) -> dict[str, object]:
    """Values under the scenario's names; an empty one (`seed:`) means the default."""
    return {
        ours: entries[theirs]
        for theirs, ours in names.items()
        if entries.get(theirs) is not None
    }


def _set(entries: _Keys) -> dict[str, object]:
    """What is given without empty values, which leave the simulator's own as it is."""
    return {name: value for name, value in entries.items() if value is not None}


def _mapping(value: object, at: str) -> _Keys:
    """Keys and values; none if nothing is given."""
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise _wrong(at, "keys and values", value)
    return {str(key): entry for key, entry in value.items()}


def _number(value: object, at: str) -> float:
    """A number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _wrong(at, "a number", value)
    return float(value)


def _truth(entries: _Keys, name: str, at: str, *, default: bool) -> bool:
    """True or false, as the scenario reads them; the default if nothing is given."""
    value = entries.get(name)
    if value is None:
        return default
    try:
        return _TRUTH.validate_python(value)
    except ValidationError:
        raise _wrong(f"{at}: {name}", "true or false", value) from None


def _note_unused(
    names: Iterable[str],
    parts: Iterable[_Keys],
    file: str,
    notes: list[str],
) -> None:
    """Add a note that lists which of these keys the parts of a file have."""
    there = {key for part in parts for key in part}
    if unused := [name for name in names if name in there]:
        notes.append(f"{file}: keys that are not used: {', '.join(unused)}")


def _refuse_unknown(entries: _Keys, keys: frozenset[str], at: str) -> None:
    """`ScenarioError` for the first key that carlasimu does not have."""
    for key in entries:
        if key not in keys:
            raise ScenarioError(
                f"{at}: {key}: unknown key; the nearest valid key is "
                f"{nearest(key, keys)!r}"
            )


def _wrong(at: str, expected: str, value: object) -> ScenarioError:
    return ScenarioError(f"{at}: expected {expected}, found {repr(value)[:60]}")


_CONVERTERS: Final[Mapping[str, Callable[[_Keys, _Scenario, list[str]], None]]] = {
    "data.yaml": _data,
    "sensors.yaml": _sensors,
    "weather.yaml": _weather,
    "mapLayer.yaml": _map_layers,
    "boundingBox.yaml": _boxes,
    "vehicles_name.yaml": _vehicles,
    "color_segmentation.yaml": _colors,
}
"""What adds each file to the scenario and to its notes, in the order of its keys."""
