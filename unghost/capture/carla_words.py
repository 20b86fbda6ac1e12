"""CARLA's words for weather, lights and layers, so that typos are found offline."""

from __future__ import annotations

from typing import Final

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
"""What bends the picture; `lens_flare_intensity` only adds light to it."""
