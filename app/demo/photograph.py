"""The colour image of a frame: light, sky, a little blur and noise of a sensor."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from app.demo.exposure import Exposure
from app.demo.shading import Lighting, ambient_occlusion, develop, shade
from app.demo.sky import sky_with_clouds
from app.demo.textures import TILE, Float32, grain_tile
from filter_core.camera import Camera

_NOISE: Final = 1.1
"""Standard deviation of the sensor's noise, in levels of 255."""


def photograph(
    exposure: Exposure, camera: Camera, light: Lighting, noise_seed: int
) -> NDArray[np.uint8]:
    """(H, W, 3) RGB."""
    height, width = camera.height, camera.width
    open_sky = ambient_occlusion(exposure.planes.depth, float(camera.intrinsic[0, 0]))
    image = np.empty((height * width, 3), dtype=np.float32)
    sky = np.flatnonzero(exposure.planes.depth.reshape(-1) >= 1000.0)
    towards = exposure.rays[sky]
    towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    image[sky] = sky_with_clouds(light.hour, towards)
    solid = exposure.solid
    image[solid] = shade(exposure.pixels, open_sky.reshape(-1)[solid], light)
    linear = image.reshape(height, width, 3)
    display = develop(_bloomed(linear, light.hour.exposure), light.hour.exposure)
    return _with_noise(display, noise_seed)


def _bloomed(light: Float32, exposure: float) -> Float32:
    """What is brighter than white spills over its surroundings."""
    small = cv2.resize(light, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    over = np.clip(small - np.float32(0.9 / exposure), 0, 3)
    spilt = cv2.GaussianBlur(over, (0, 0), 6)
    spilt = cv2.resize(spilt, (light.shape[1], light.shape[0]))
    return np.asarray(light + 0.16 * spilt)


def _with_noise(display: Float32, seed: int) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    height, width = display.shape[:2]
    tiles = (-(-height // TILE) + 1, -(-width // TILE) + 1)
    row, column = rng.integers(TILE, size=2)
    grain = np.tile(grain_tile(71), tiles)[row : row + height, column : column + width]
    noisy = display + (grain * np.float32(_NOISE))[..., None]
    return np.asarray(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
