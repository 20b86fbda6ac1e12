"""Noise that repeats: grain of asphalt, stains of plaster, clouds, the sensor."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Final, TypeAlias

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

Float32: TypeAlias = NDArray[np.floating[Any]]
"""Single precision; numpy's stubs lose track of it where numbers are mixed in."""

TILE: Final = 512
_MASK: Final = TILE - 1


def f32(values: ArrayLike) -> Float32:
    """Numbers as single-precision numbers."""
    return np.asarray(values, dtype=np.float32)


@lru_cache(maxsize=32)
def cloudy_tile(seed: int, octaves: int = 6, roughness: float = 0.55) -> Float32:
    """(TILE, TILE) fractal noise of mean 0 and deviation 1; tiles without a seam."""
    rng = np.random.default_rng(seed)
    total = np.zeros((TILE, TILE), dtype=np.float32)
    for octave in range(octaves):
        cells = 4 << octave
        grid = rng.standard_normal((cells, cells)).astype(np.float32)
        total += roughness**octave * _enlarged(grid)
    return np.asarray((total - total.mean()) / total.std())


@lru_cache(maxsize=32)
def grain_tile(seed: int) -> Float32:
    """(TILE, TILE) white noise of mean 0 and deviation 1."""
    rng = np.random.default_rng(seed)
    return rng.standard_normal((TILE, TILE), dtype=np.float32)


def _enlarged(grid: Float32) -> Float32:
    wrapped = np.pad(grid, 2, mode="wrap")
    scale = TILE // len(grid)
    size = len(wrapped) * scale
    large = cv2.resize(wrapped, (size, size), interpolation=cv2.INTER_CUBIC)
    return np.asarray(large[2 * scale : -2 * scale, 2 * scale : -2 * scale])


def sample(tile: Float32, u: Float32, v: Float32, per_unit: float) -> Float32:
    """The tile's value at each place (nearest), with `per_unit` texels per unit."""
    row = (v * np.float32(per_unit)).astype(np.int32) & _MASK
    column = (u * np.float32(per_unit)).astype(np.int32) & _MASK
    return np.asarray(tile.reshape(-1)[row * TILE + column])


def hashed(*whole: NDArray[np.int32]) -> Float32:
    """A number in 0..1 for each combination of whole numbers, always the same."""
    state = np.zeros(whole[0].shape, dtype=np.uint32)
    for part in whole:
        state = (state ^ part.astype(np.uint32)) * np.uint32(0x9E3779B1)
        state ^= state >> np.uint32(15)
        state *= np.uint32(0x85EBCA6B)
        state ^= state >> np.uint32(13)
    return np.asarray((state >> np.uint32(8)).astype(np.float32) / np.float32(1 << 24))


def coverage(inside: Float32, footprint: Float32 | float) -> Float32:
    """Share of a pixel within a shape, from the signed distance to its edge."""
    return np.asarray(np.clip(inside / footprint + np.float32(0.5), 0.0, 1.0))


def mixed(below: Float32, above: Float32, share: Float32) -> Float32:
    """(N, 3) colours blended, `share` (N,) of the one above."""
    return np.asarray(below + (above - below) * share[:, None])
