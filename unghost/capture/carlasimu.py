"""carlasimu's seven YAML files as one scenario."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import yaml

from filter_core.classes import class_of
from filter_core.values import nearest
from unghost.capture.carla_words import MAP_LAYERS, VEHICLE_LIGHTS
from unghost.capture.carlasimu_sensors import sensors_of
from unghost.capture.carlasimu_values import (
    list_of,
    mapping_of,
    number_of,
    refuse_unknown,
)
from unghost.capture.errors import ScenarioError
from unghost.capture.scenario import parse_scenario, read_yaml

_TOP: Final = "sitting"
"""carlasimu's own spelling of the key that everything stands under."""
FILES: Final = (
    "data.yaml",
    "sensors.yaml",
    "weather.yaml",
    "mapLayer.yaml",
    "boundingBox.yaml",
    "vehicles_name.yaml",
    "color_segmentation.yaml",
)
_LAYERS: Final = {"building": "Buildings"}
_DATA_KEYS: Final = frozenset(
    {
        "host", "port", "tm_port", "asynch", "hybrid", "no_rendering", "synchronous",
        "apply_settings", "safe", "filterv", "filterw", "number_of_wheels",
        "generationv", "generationw", "number_of_vehicles", "number_of_walkers",
        "car_lights_on", "hero", "respawn", "global_distance_to_leading_vehicle",
        "physics_mode", "physics_radius", "light_state", "seed", "seedw", "set_timeout",
        "wait_for_tick", "fixed_delta_seconds",
    }
)  # fmt: skip
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
    "safe": "safe",
    "car_lights_on": "automatic_lights",
}
_WITHOUT_MEANING: Final = ("apply_settings", "hero", "physics_mode", "wait_for_tick")
_BOX_KEYS: Final = frozenset(
    {
        "cam_rgb", "image_segmentation", "radar_sensor", "lidar_sensor",
        "depth_image_sensor", "fiter_boundinbox", "threshold_small_box", "size_big_box",
        "threshold_big_box", "time_screen_shot",
    }
)  # fmt: skip


_SENSOR_PARTS: Final = (
    *("cam_rgb", "image_segmentation", "radar_sensor", "lidar_sensor"),
    "depth_image_sensor",
)


@dataclass
class Conversion:
    """A scenario as its YAML says it, and what did not come along.

    Attributes
    ----------
    scenario : dict
        Valid; keys that are as by default are left out where nobody set them.
    notes : list of str
    """

    scenario: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def as_yaml(self) -> str:
        """The file: the notes as comments, then the scenario."""
        comments = "".join(f"# {note}\n" for note in self.notes)
        return comments + yaml.safe_dump(self.scenario, sort_keys=False)


def convert_carlasimu(folder: Path) -> Conversion:
    """carlasimu's `yaml_files` as a scenario; an absent file is as by default.

    Raises
    ------
    ScenarioError
        No such file at all, an unknown key (names the nearest), or a wrong value.
    """
    found = {name: _read(folder / name) for name in FILES if (folder / name).is_file()}
    if not found:
        raise ScenarioError(f"{folder.name}: none of {', '.join(FILES)} is there")
    result = Conversion()
    for name in FILES:
        if name in found:
            _CONVERTERS[name](found[name], result)
            parse_scenario(result.scenario, name)
    return result


def _read(path: Path) -> Mapping[str, Any]:
    document = read_yaml(path.read_bytes(), path.name)
    inner = document.get(_TOP) if isinstance(document, Mapping) else None
    if not isinstance(inner, Mapping):
        raise ScenarioError(f"{path.name}: expected keys under {_TOP!r}")
    return mapping_of(inner, path.name)


def _data(given: Mapping[str, Any], result: Conversion) -> None:
    refuse_unknown(given, _DATA_KEYS, "data.yaml")
    scenario = result.scenario
    scenario.update(_taken(given, _PLAIN))
    scenario["traffic_manager"] = _taken(given, _MANAGER)
    vehicles = _taken(given, _VEHICLES)
    for name, key in (("number_of_wheels", "wheels"), ("generationv", "generation")):
        if name in given:
            vehicles[key] = _number_or_all(given[name])
    lights = mapping_of(given.get("light_state"), "data.yaml: light_state")
    vehicles["lights"] = _lights(lights)
    scenario["vehicles"] = vehicles
    scenario["walkers"] = _walkers(given)
    unused = [name for name in _WITHOUT_MEANING if name in given]
    if unused:
        result.notes.append(f"data.yaml: not used here: {', '.join(unused)}")
    if given.get("asynch") or given.get("synchronous") is False:
        result.notes.append("always synchronous: asynch and synchronous are not used")
    if given.get("no_rendering"):
        result.notes.append("no_rendering is not used: cameras need rendering")


def _walkers(given: Mapping[str, Any]) -> dict[str, Any]:
    walkers = _taken(given, {"filterw": "filter", "seedw": "seed"})
    if "generationw" in given:
        walkers["generation"] = _number_or_all(given["generationw"])
    at = "data.yaml: number_of_walkers"
    counts = mapping_of(given.get("number_of_walkers"), at)
    names = {"stand": "standing", "walk": "walking", "run": "running"}
    refuse_unknown(counts, frozenset(names), at)
    return {**walkers, **_taken(counts, names)}


def _lights(states: Mapping[str, Any]) -> list[str]:
    known = {name.casefold(): name for name in VEHICLE_LIGHTS}
    lower = {name.casefold(): on for name, on in states.items()}
    for name in states:
        if name.casefold() not in known:
            raise ScenarioError(
                f"data.yaml: light_state.{name}: unknown light; the nearest is "
                f"{nearest(name, VEHICLE_LIGHTS)!r}"
            )
    return [name for key, name in known.items() if lower.get(key)]


def _number_or_all(value: object) -> object:
    text = str(value).casefold()
    return int(text) if text.isdecimal() else text


def _weather(given: Mapping[str, Any], result: Conversion) -> None:
    numbers = {
        name: number_of(value, f"weather.yaml: {name}") for name, value in given.items()
    }
    result.scenario["weather"] = {"parameters": numbers}


def _map_layers(given: Mapping[str, Any], result: Conversion) -> None:
    known = {**{name: name for name in MAP_LAYERS}, **_LAYERS}
    refuse_unknown(given, frozenset(known), "mapLayer.yaml")
    # A layer that is there already need not be loaded.
    off = {known[name]: False for name, wanted in given.items() if wanted is False}
    result.scenario["map_layers"] = off


def _boxes(given: Mapping[str, Any], result: Conversion) -> None:
    refuse_unknown(given, _BOX_KEYS, "boundingBox.yaml")
    parts = {
        name: mapping_of(given.get(name), f"boundingBox.yaml: {name}")
        for name in _SENSOR_PARTS
    }
    camera, scenario = parts["cam_rgb"], result.scenario
    actors = mapping_of(camera.get("actors"), "boundingBox.yaml: cam_rgb.actors")
    scenario["boxes"] = {
        **_taken(
            camera, {"min_distance": "min_distance", "max_distance": "max_distance"}
        ),
        **_taken(actors, {"vehicles": "vehicles", "walkers": "walkers"}),
        "parked_vehicles": False,
        "traffic_lights": False,
    }
    scenario.update(_taken(camera, {"num_image": "frames"}))
    scenario.update(_taken(given, {"time_screen_shot": "interval_s"}))
    sensors = scenario.setdefault("sensors", {})
    wanted = {
        "rgb": ("cam_rgb", True),
        "segmentation": ("image_segmentation", True),
        "depth": ("depth_image_sensor", False),
        "lidar": ("lidar_sensor", False),
        "radar": ("radar_sensor", False),
    }
    for name, (theirs, default) in wanted.items():
        if not parts[theirs].get("save_to_file", default):
            sensors[name] = False
    sensors["semantic_lidar"] = False
    result.notes.append(
        "the thresholds of boundingBox.yaml belong to the filter: "
        "unghost filter --config boundingBox.yaml reads them"
    )


def _vehicles(given: Mapping[str, Any], result: Conversion) -> None:
    named = {
        str(blueprint): name
        for name, blueprints in given.items()
        for blueprint in list_of(blueprints, f"vehicles_name.yaml: {name}")
    }
    own = {
        blueprint: name
        for blueprint, name in named.items()
        if class_of(blueprint, None) != name
    }
    if own:
        result.scenario["classes"] = own


def _colors(given: Mapping[str, Any], result: Conversion) -> None:
    result.notes.append(
        f"color_segmentation.yaml is not needed: tags are stored as numbers "
        f"({len(given)} colours left behind)"
    )


def _sensors(given: Mapping[str, Any], result: Conversion) -> None:
    result.scenario.update(sensors_of(given, result.notes))


def _taken(given: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """Values under our names; an empty one (`seed:`) is as by default."""
    return {
        ours: given[theirs]
        for theirs, ours in names.items()
        if given.get(theirs) is not None
    }


_CONVERTERS: Final[Mapping[str, Callable[[Mapping[str, Any], Conversion], None]]] = {
    "data.yaml": _data,
    "sensors.yaml": _sensors,
    "weather.yaml": _weather,
    "mapLayer.yaml": _map_layers,
    "boundingBox.yaml": _boxes,
    "vehicles_name.yaml": _vehicles,
    "color_segmentation.yaml": _colors,
}
