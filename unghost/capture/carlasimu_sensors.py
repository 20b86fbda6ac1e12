"""The sensors of carlasimu: one camera for all, attributes as CARLA names them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from unghost.capture.carla_words import LENS_ATTRIBUTES
from unghost.capture.carlasimu_values import mapping_of, number_of, refuse_unknown
from unghost.capture.errors import ScenarioError

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
_NOT_ATTRIBUTES: Final = frozenset({"location", "sensor_tick", *_SHARED})


def sensors_of(given: Mapping[str, Any], notes: list[str]) -> dict[str, Any]:
    """`camera` and `sensors` of a scenario, from what stands in sensors.yaml."""
    refuse_unknown(given, frozenset(_NAMES), "sensors.yaml")
    given = {
        name: mapping_of(one, f"sensors.yaml: {name}") for name, one in given.items()
    }
    nothing: Mapping[str, Any] = {}
    first = next((given[name] for name in _CAMERAS if name in given), nothing)
    lens = _lens(first)
    for name in _CAMERAS:
        other = given.get(name)
        if other is not None and _geometry(other) != _geometry(first):
            notes.append(
                f"sensors.yaml: {name} differs from the other cameras; all cameras "
                "share one size, place and lens here"
            )
    camera = {ours: first[name] for name, ours in _SHARED.items() if name in first}
    camera |= {"mount": mount} if (mount := _mount(first, "camera")) else {}
    camera |= {"lens": lens} if lens else {}
    return {
        "camera": camera,
        "sensors": {
            _NAMES[name]: _sensor(name, one, notes) for name, one in given.items()
        },
    }


def _geometry(camera: Mapping[str, Any]) -> tuple[object, ...]:
    sizes = tuple(camera.get(name) for name in _SHARED)
    return (*sizes, camera.get("location"), _lens(camera))


def _lens(camera: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in camera.items() if name in LENS_ATTRIBUTES}


def _mount(sensor: Mapping[str, Any], name: str) -> dict[str, float]:
    location = sensor.get("location")
    if location is None:
        return {}
    at = f"sensors.yaml: {name}.location"
    if not isinstance(location, list) or len(location) != 2:
        raise ScenarioError(f"{at}: expected x and z")
    return {"x": number_of(location[0], at), "z": number_of(location[1], at)}


def _sensor(name: str, sensor: Mapping[str, Any], notes: list[str]) -> dict[str, Any]:
    if sensor.get("sensor_tick"):
        notes.append(
            f"sensors.yaml: {name}.sensor_tick is not used: it drifts against the "
            "world's ticks; interval_s says when a frame is recorded"
        )
    lens = _lens(sensor) if name in _CAMERAS else {}
    attributes = {
        key: value
        for key, value in sensor.items()
        if key not in _NOT_ATTRIBUTES and key not in lens
    }
    if name in _CAMERAS:
        return {"attributes": attributes}
    mount = _mount(sensor, name)
    return {**({"mount": mount} if mount else {}), "attributes": attributes}
