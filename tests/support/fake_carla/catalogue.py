"""The blueprints of the fake simulator, and their library."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase

from carla import ActorAttributeType as Type

# The attributes and defaults of CARLA 0.9.14 to 0.9.16, as its server declares them
# (ActorBlueprintFunctionLibrary.cpp); the client library does not have them.
_CAMERA = {
    "image_size_x": "800", "image_size_y": "600", "fov": "90.0", "sensor_tick": "0.0",
    "lens_circle_falloff": "5.0", "lens_circle_multiplier": "0.0", "lens_k": "-1.0",
    "lens_kcube": "0.0", "lens_x_size": "0.08", "lens_y_size": "0.08",
    "role_name": "front",
}  # fmt: skip
_PHOTO = {
    "enable_postprocess_effects": "true", "gamma": "2.2", "iso": "100.0",
    "motion_blur_intensity": "0.45", "motion_blur_max_distortion": "0.35",
    "motion_blur_min_object_screen_size": "0.1", "lens_flare_intensity": "0.1",
    "bloom_intensity": "0.675", "exposure_mode": "histogram",
    "exposure_compensation": "0.0", "shutter_speed": "200.0", "fstop": "1.4",
    "exposure_min_bright": "10.0", "exposure_max_bright": "12.0",
    "exposure_speed_up": "3.0", "exposure_speed_down": "1.0",
    "calibration_constant": "16.0", "focal_distance": "1000.0", "min_fstop": "1.2",
    "blade_count": "5", "blur_amount": "1.0", "blur_radius": "0.0", "slope": "0.88",
    "toe": "0.55", "shoulder": "0.26", "black_clip": "0.0", "white_clip": "0.04",
    "temp": "6500.0", "tint": "0.0", "chromatic_aberration_intensity": "0.0",
    "chromatic_aberration_offset": "0.0",
}  # fmt: skip
_LIDAR = {
    "channels": "32", "range": "10.0", "points_per_second": "56000",
    "rotation_frequency": "10.0", "upper_fov": "10.0", "lower_fov": "-30.0",
    "horizontal_fov": "360.0", "sensor_tick": "0.0", "role_name": "front",
}  # fmt: skip
_RETURNS = {
    "atmosphere_attenuation_rate": "0.004", "dropoff_general_rate": "0.45",
    "dropoff_intensity_limit": "0.8", "dropoff_zero_intensity": "0.4",
    "noise_stddev": "0.0", "noise_seed": "0",
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
    "vehicle.carlamotors.carlacola": _vehicle("truck"),
    "vehicle.carlamotors.european_hgv": _vehicle("truck"),
    "vehicle.carlamotors.firetruck": _vehicle("truck"),
    "vehicle.mercedes.sprinter": _vehicle("van"),
    "vehicle.bh.crossbike": _vehicle("bicycle", wheels="2", generation="1"),
    "walker.pedestrian.0001": {
        "generation": "1", "is_invincible": "true", "speed": "1.4", "role_name": "",
    },
    "controller.ai.walker": {"role_name": ""},
    "sensor.camera.rgb": {**_CAMERA, **_PHOTO},
    "sensor.camera.semantic_segmentation": _CAMERA,
    "sensor.camera.instance_segmentation": _CAMERA,
    "sensor.camera.depth": _CAMERA,
    "sensor.lidar.ray_cast": {**_LIDAR, **_RETURNS},
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
        *("number_of_wheels", "generation", "blade_count", "noise_seed"),
    },
    Type.String: {"base_type", "role_name", "exposure_mode"},
    Type.Bool: {"is_invincible", "enable_postprocess_effects"},
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
