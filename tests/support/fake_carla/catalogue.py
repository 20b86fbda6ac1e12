"""The blueprints of the fake simulator, and their library."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase

from carla import ActorAttributeType as Type

_CAMERA = {
    "image_size_x": "800", "image_size_y": "600", "fov": "90.0", "sensor_tick": "0.0",
    "lens_circle_falloff": "5.0", "lens_k": "-1.0", "lens_kcube": "0.0",
    "role_name": "front",
}  # fmt: skip
_LIDAR = {
    "channels": "32", "range": "10.0", "points_per_second": "56000",
    "rotation_frequency": "10.0", "upper_fov": "10.0", "lower_fov": "-30.0",
    "sensor_tick": "0.0", "role_name": "front",
}  # fmt: skip


def _vehicle(
    base_type: str, wheels: str = "4", generation: str = "2"
) -> dict[str, str]:
    return {
        "base_type": base_type, "number_of_wheels": wheels, "generation": generation,
        "role_name": "autopilot", "color": "0,0,0",
    }  # fmt: skip


BLUEPRINTS: Mapping[str, Mapping[str, str]] = {
    "vehicle.tesla.model3": _vehicle("car"),
    "vehicle.lincoln.mkz_2020": _vehicle("car"),
    "vehicle.mitsubishi.fusorosa": _vehicle("bus", generation="1"),
    "vehicle.bh.crossbike": _vehicle("bicycle", wheels="2", generation="1"),
    "walker.pedestrian.0001": {
        "generation": "1", "is_invincible": "true", "speed": "1.4", "role_name": "",
    },
    "controller.ai.walker": {"role_name": ""},
    "sensor.camera.rgb": {**_CAMERA, "iso": "100.0", "gamma": "2.2"},
    "sensor.camera.semantic_segmentation": _CAMERA,
    "sensor.camera.instance_segmentation": _CAMERA,
    "sensor.camera.depth": _CAMERA,
    "sensor.lidar.ray_cast": {**_LIDAR, "noise_stddev": "0.0"},
    "sensor.lidar.ray_cast_semantic": _LIDAR,
    "sensor.other.radar": {
        "range": "100", "points_per_second": "1500", "horizontal_fov": "30",
        "vertical_fov": "30", "sensor_tick": "0.0", "role_name": "front",
    },
}  # fmt: skip
_NOT_MODIFIABLE = {"base_type", "number_of_wheels", "generation"}
_TYPES = {
    Type.Int: {
        *("image_size_x", "image_size_y", "channels", "points_per_second"),
        *("number_of_wheels", "generation"),
    },
    Type.String: {"base_type", "role_name"},
    Type.Bool: {"is_invincible"},
    Type.RGBColor: {"color"},
}
"""The attribute types that the simulator declares; all other attributes are Float."""


class ActorAttribute:
    def __init__(self, name: str, value: str) -> None:
        self.id, self._value = name, value
        kinds = (kind for kind, names in _TYPES.items() if name in names)
        self.type = next(kinds, Type.Float)
        self.is_modifiable = name not in _NOT_MODIFIABLE
        self.recommended_values: list[str] = (
            ["255,0,0", "0,0,255"] if name == "color" else []
        )

    def _of(self, kind: Type) -> str:
        """The value as text; raises for another type, as the real library does."""
        if self.type != kind:
            raise RuntimeError(f"{self.id}: bad attribute cast: cannot convert")
        return self._value

    def as_str(self) -> str:
        return self._of(Type.String)

    def as_int(self) -> int:
        return int(self._of(Type.Int))


class ActorBlueprint:
    def __init__(self, type_id: str, attributes: Mapping[str, str]) -> None:
        self.id, self.attributes = type_id, dict(attributes)

    def has_attribute(self, arg2: str) -> bool:
        return arg2 in self.attributes

    def get_attribute(self, arg2: str) -> ActorAttribute:
        return ActorAttribute(arg2, self.attributes[arg2])

    def set_attribute(self, arg2: str, arg3: str) -> None:
        if not isinstance(arg3, str):
            raise TypeError("values of attributes are texts")
        if arg2 not in self.attributes:
            raise IndexError(f"blueprint '{self.id}' has no attribute '{arg2}'")
        if not self.get_attribute(arg2).is_modifiable:
            raise ValueError(f"{arg2}: read-only attribute")
        self.attributes[arg2] = arg3

    def __iter__(self) -> Iterator[ActorAttribute]:
        return iter([self.get_attribute(name) for name in self.attributes])

    def __len__(self) -> int:
        return len(self.attributes)


class BlueprintLibrary:
    def __init__(self, blueprints: list[ActorBlueprint] | None = None) -> None:
        made = [ActorBlueprint(name, each) for name, each in BLUEPRINTS.items()]
        self._blueprints = made if blueprints is None else blueprints

    def find(self, id: str) -> ActorBlueprint:
        for blueprint in self._blueprints:
            if blueprint.id == id:
                return blueprint
        raise IndexError(f"blueprint '{id}' not found")

    def filter(self, wildcard_pattern: str) -> BlueprintLibrary:
        chosen = [b for b in self._blueprints if fnmatchcase(b.id, wildcard_pattern)]
        return BlueprintLibrary(chosen)

    def __iter__(self) -> Iterator[ActorBlueprint]:
        return iter(self._blueprints)

    def __len__(self) -> int:
        return len(self._blueprints)

    def __getitem__(self, arg2: int) -> ActorBlueprint:
        return self._blueprints[arg2]
