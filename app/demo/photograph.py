"""The colour image of a frame: light, sky, smooth edges, the noise of a sensor."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from app.demo.exposure import SKY, Planes, Samples, pixel_corners, surfaces
from app.demo.ground import RoadPlan
from app.demo.shading import Lighting, Pixels, ambient_occlusion, develop, shade
from app.demo.sky import sky_with_clouds
from app.demo.snapshot import Snapshot
from app.demo.textures import TILE, Float32, grain_tile
from filter_core.types import IntArray

_NOISE: Final = 1.1
"""Standard deviation of the sensor's noise, in levels of 255."""


class Photographer:
    """Takes the colour image of one snapshot."""

    def __init__(self, snapshot: Snapshot, plan: RoadPlan, light: Lighting) -> None:
        self._snapshot, self._plan, self._light = snapshot, plan, light

    def photograph(
        self, samples: Samples, pixels: Pixels, planes: Planes, noise_seed: int
    ) -> NDArray[np.uint8]:
        """(H, W, 3) RGB, from the pixels' centres and what they show."""
        height, width = planes.depth.shape
        focal = float(self._snapshot.camera.intrinsic[0, 0])
        open_sky = ambient_occlusion(planes.depth, focal).reshape(-1)
        image = self._colors(samples, open_sky, pixels)
        exposure = self._light.hour.exposure
        self._smooth_edges(image, samples, open_sky)
        linear = image.reshape(height, width, 3)
        return _with_noise(develop(_bloomed(linear, exposure), exposure), noise_seed)

    def _colors(
        self, samples: Samples, open_sky: Float32, pixels: Pixels | None = None
    ) -> Float32:
        """(N, 3) linear light of samples; `open_sky` (N,) is their share of it."""
        light = np.empty((len(samples.winner), 3), dtype=np.float32)
        sky = np.flatnonzero(samples.winner == SKY)
        towards = samples.rays[sky]
        towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
        light[sky] = sky_with_clouds(self._light.hour, towards)
        solid = np.flatnonzero(samples.winner != SKY)
        if pixels is None:
            pixels, _ = surfaces(self._snapshot, samples.part(solid), self._plan)
        light[solid] = shade(pixels, open_sky[solid], self._light)
        return light

    def _smooth_edges(
        self, image: Float32, samples: Samples, open_sky: Float32
    ) -> None:
        """Mix in the corners of pixels that show more than one triangle."""
        camera = self._snapshot.camera
        corners = pixel_corners(self._snapshot)
        edge = _edges(samples.winner, corners.winner, (camera.height, camera.width))
        row, column = np.divmod(edge, camera.width)
        first = row * (camera.width + 1) + column
        four = np.stack(
            [first, first + 1, first + camera.width + 1, first + camera.width + 2]
        )
        used = np.zeros(len(corners.winner), dtype=bool)
        used[four] = True
        chosen = np.flatnonzero(used)
        place = np.zeros(len(used), dtype=np.int32)
        place[chosen] = np.arange(len(chosen))
        nearest_pixel = np.zeros(len(used), dtype=np.int64)
        nearest_pixel[four] = edge
        colors = self._colors(corners.part(chosen), open_sky[nearest_pixel[chosen]])
        image[edge] *= 0.5
        for corner in four:
            image[edge] += colors[place[corner]] * np.float32(0.125)


def _edges(
    centre: NDArray[np.int32], corner: NDArray[np.int32], hw: tuple[int, int]
) -> IntArray:
    """Flat indices of pixels with a corner that shows another triangle."""
    height, width = hw
    middle = centre.reshape(height, width)
    around = corner.reshape(height + 1, width + 1)
    differs = middle != around[:-1, :-1]
    differs |= middle != around[:-1, 1:]
    differs |= middle != around[1:, :-1]
    differs |= middle != around[1:, 1:]
    return np.flatnonzero(differs)


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
