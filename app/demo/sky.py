"""The light of an hour: sun, sky, clouds, haze."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from app.demo.mesh import along
from app.demo.textures import TILE, Float32, cloudy_tile, f32

RGB = tuple[float, float, float]


@dataclass(frozen=True)
class Hour:
    """Light in linear units; the sun's direction points towards the sun.

    Attributes
    ----------
    sun : (x, y, z), unit length
    sunlight, zenith, horizon, bounce : light of the sun, the sky, and from the ground
    haze : share of the view lost per metre
    clouds : 0..1
    exposure : what the camera multiplies with
    """

    sun: RGB
    sunlight: RGB
    zenith: RGB
    horizon: RGB
    bounce: RGB
    haze: float
    clouds: float
    exposure: float


def sky_light(hour: Hour, direction: Float32) -> Float32:
    """(N, 3): light from each direction of the sky, without clouds."""
    height = np.clip(direction[:, 2], 0.0, 1.0)
    share = np.sqrt(height)[:, None]
    low, high = f32(hour.horizon), f32(hour.zenith)
    light = low + (high - low) * share
    towards = np.clip(along(direction, hour.sun), 0.0, 1.0)
    halo = 0.28 * towards**6 + 0.55 * towards**48
    return light + f32(hour.sunlight) * (0.22 * halo)[:, None]


def mirrored_surroundings(hour: Hour, direction: Float32) -> Float32:
    """(N, 3): what a mirror in a street shows: sky above, dull houses, road below."""
    light = sky_light(hour, direction)
    house = f32(hour.bounce) * 1.1 + f32(hour.horizon) * 0.10
    # Roof lines are not level: a wobble around the horizon makes the mirror believable.
    bearing = np.arctan2(direction[:, 1], direction[:, 0])
    roofs = 0.22 + 0.10 * np.sin(7.0 * bearing) * np.sin(17.0 * bearing + 1.0)
    above = np.clip((direction[:, 2] - roofs) / 0.06 + 0.5, 0.0, 1.0)[:, None]
    below = np.clip(-direction[:, 2] / 0.1, 0.0, 1.0)[:, None]
    surroundings = house + (f32(hour.bounce) * 0.55 - house) * below
    mirrored: Float32 = surroundings + (light - surroundings) * above
    return mirrored


def sky_with_clouds(hour: Hour, direction: Float32) -> Float32:
    """(N, 3): the sky as the camera sees it."""
    light = sky_light(hour, direction)
    if hour.clouds <= 0:
        return light
    height = np.maximum(direction[:, 2], 0.02)
    scale = 130.0 / (height + 0.12)
    u, v = direction[:, 0] * scale, direction[:, 1] * scale
    density = _bilinear(cloudy_tile(11), u, v)
    towards_sun = f32(hour.sun[:2]) * 9.0
    lit_side = _bilinear(cloudy_tile(11), u + towards_sun[0], v + towards_sun[1])
    cover = np.clip((density + 2.4 * hour.clouds - 1.35) * 0.75, 0.0, 1.0)
    cover *= np.clip(height * 7.0, 0.0, 1.0) * 0.92
    shine = np.clip(0.86 + 0.22 * (density - lit_side), 0.5, 1.25)
    white = f32(hour.horizon) * 0.62 + f32(hour.sunlight) * 0.20
    clouds = white * shine[:, None]
    seen: Float32 = light + (clouds - light) * cover[:, None]
    return seen


def _bilinear(tile: Float32, u: Float32, v: Float32) -> Float32:
    maps = [np.mod(axis, TILE).reshape(1, -1).astype(np.float32) for axis in (u, v)]
    # remap refuses more than 32767 columns: fold the row.
    width = 16384
    padding = -maps[0].shape[1] % width
    folded = [np.pad(axis[0], (0, padding)).reshape(-1, width) for axis in maps]
    values = cv2.remap(
        tile, folded[0], folded[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
    )
    return f32(values).reshape(-1)[: maps[0].shape[1]]
