"""The colour image of a frame: light, sky, smooth edges, the noise of a sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from app.demo.exposure import (
    SKY,
    Planes,
    Samples,
    pixel_corners,
    planes_of,
    surfaces,
)
from app.demo.ground import RoadPlan
from app.demo.paint import Tag
from app.demo.shading import Lighting, ambient_occlusion, develop, shade
from app.demo.sky import sky_with_clouds
from app.demo.snapshot import Snapshot
from app.demo.textures import TILE, Float32, grain_tile
from filter_core.types import IntArray, TagImage

_NOISE: Final = 1.1
"""Standard deviation of the sensor's noise, in levels of 255."""
_SAMPLES_AT_ONCE: Final = 1 << 16


@dataclass(frozen=True, eq=False)
class Shot:
    """What a snapshot shows at N samples, and its light.

    Attributes
    ----------
    light : (N, 3) linear
    tags : (N,) uint8
    normals : (N, 3), zero for the sky
    """

    light: Float32
    tags: TagImage
    normals: Float32


class Photographer:
    """Takes the colour image of one snapshot."""

    def __init__(self, snapshot: Snapshot, plan: RoadPlan, light: Lighting) -> None:
        self._snapshot, self._plan, self._light = snapshot, plan, light

    def photograph(
        self, samples: Samples, noise_seed: int
    ) -> tuple[NDArray[np.uint8], Planes]:
        """(H, W, 3) RGB and the planes, from the pixels' centres."""
        camera = self._snapshot.camera
        height, width = camera.height, camera.width
        depth = samples.depth.reshape(height, width)
        open_sky = ambient_occlusion(depth, float(camera.intrinsic[0, 0])).reshape(-1)
        shot = self._shoot(samples, open_sky)
        self._smooth_edges(shot.light, samples, open_sky)
        exposure = self._light.hour.exposure
        linear = _bloomed(shot.light.reshape(height, width, 3), exposure)
        image = _with_noise(develop(linear, exposure), noise_seed)
        return image, planes_of(self._snapshot, samples, shot.tags, shot.normals)

    def _shoot(self, samples: Samples, open_sky: Float32) -> Shot:
        """All samples; `open_sky` (N,) is their share of the sky's light."""
        count = len(samples.winner)
        shot = Shot(
            np.empty((count, 3), dtype=np.float32),
            np.full(count, Tag.SKY, dtype=np.uint8),
            np.zeros((count, 3), dtype=np.float32),
        )
        sky = np.flatnonzero(samples.winner == SKY)
        towards = samples.rays[sky]
        towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
        shot.light[sky] = sky_with_clouds(self._light.hour, towards)
        solid = np.flatnonzero(samples.winner != SKY)
        # In pieces that fit into the processor's cache.
        for begin in range(0, len(solid), _SAMPLES_AT_ONCE):
            piece = solid[begin : begin + _SAMPLES_AT_ONCE]
            pixels, tags = surfaces(self._snapshot, samples.part(piece), self._plan)
            shot.tags[piece], shot.normals[piece] = tags, pixels.normal
            shot.light[piece] = shade(pixels, open_sky[piece], self._light)
        return shot

    def _smooth_edges(
        self, image: Float32, samples: Samples, open_sky: Float32
    ) -> None:
        """Mix in the corners of pixels that show more than one triangle."""
        camera = self._snapshot.camera
        corners = pixel_corners(self._snapshot)
        edge = _edges(samples.winner, corners.winner, (camera.height, camera.width))
        row, column = np.divmod(edge, camera.width)
        first = row * (camera.width + 1) + column
        below = first + camera.width + 1
        four = np.stack([first, first + 1, below, below + 1])
        used = np.zeros(len(corners.winner), dtype=bool)
        used[four] = True
        chosen = np.flatnonzero(used)
        place = np.zeros(len(used), dtype=np.int32)
        place[chosen] = np.arange(len(chosen))
        nearest_pixel = np.zeros(len(used), dtype=np.int64)
        nearest_pixel[four] = edge
        shot = self._shoot(corners.part(chosen), open_sky[nearest_pixel[chosen]])
        mixed = image[edge] * np.float32(0.5)
        for corner in four:
            mixed += shot.light[place[corner]] * np.float32(0.125)
        image[edge] = mixed


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
