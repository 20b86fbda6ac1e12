"""Materials of surfaces: colours, gloss, CARLA's tags, and tiled noise.

A `Paint` is the look of a triangle, a row of numbers that the shaders read. Noise comes
from tiles without a seam, so that asphalt, plaster, clouds and the sensor's grain are
the same on every machine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from functools import lru_cache
from typing import Any, Final, TypeAlias

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from filter_core.segmentation.palettes import palette_of

FAMILY: Final = "carla-0.9.14"
SURFACE_COLUMNS: Final = 10
"""red, green, blue (linear), gloss, glow, kind, four parameters of the kind."""
DYE_COLUMN: Final = 6
"""The first parameter: of a plain surface, the number of its dye, or 0."""
RGB: TypeAlias = tuple[float, float, float]
"""A colour: sRGB from 0 to 255 in paints, linear light from 0 up in lighting."""
Float32: TypeAlias = NDArray[np.floating[Any]]
"""Single precision; numpy's stubs lose track of it where numbers are mixed in."""
TILE: Final = 512
_MASK: Final = TILE - 1
_PALETTE: Final = palette_of(FAMILY)


class Tag:
    """The tags that the street uses, looked up by name in the palette."""

    ROAD: Final = _PALETTE.tag_of("Road")
    SIDEWALK: Final = _PALETTE.tag_of("Sidewalk")
    BUILDING: Final = _PALETTE.tag_of("Building")
    WALL: Final = _PALETTE.tag_of("Wall")
    FENCE: Final = _PALETTE.tag_of("Fence")
    POLE: Final = _PALETTE.tag_of("Pole")
    TRAFFIC_LIGHT: Final = _PALETTE.tag_of("TrafficLight")
    TRAFFIC_SIGN: Final = _PALETTE.tag_of("TrafficSign")
    VEGETATION: Final = _PALETTE.tag_of("Vegetation")
    TERRAIN: Final = _PALETTE.tag_of("Terrain")
    SKY: Final = _PALETTE.tag_of("Sky")
    PEDESTRIAN: Final = _PALETTE.tag_of("Pedestrian")
    RIDER: Final = _PALETTE.tag_of("Rider")
    CAR: Final = _PALETTE.tag_of("Car")
    TRUCK: Final = _PALETTE.tag_of("Truck")
    BUS: Final = _PALETTE.tag_of("Bus")
    MOTORCYCLE: Final = _PALETTE.tag_of("Motorcycle")
    BICYCLE: Final = _PALETTE.tag_of("Bicycle")
    STATIC: Final = _PALETTE.tag_of("Static")
    ROAD_LINE: Final = _PALETTE.tag_of("RoadLine")


class SurfaceKind(IntEnum):
    """Which rule shades a surface; PLAIN is a single colour."""

    PLAIN = 0
    LEAF = 1
    FACADE = 2
    MASONRY = 3
    PAVING = 4
    GRASS = 5


@dataclass(frozen=True)
class Paint:
    """The look of a surface.

    Attributes
    ----------
    rgb : sRGB, 0..255
    gloss : 0..1, the share of light mirrored when looking straight on
    glow : light given off, in multiples of the colour
    kind : `SurfaceKind`
    params : what the kind's shader needs
    """

    rgb: RGB
    gloss: float = 0.0
    glow: float = 0.0
    kind: SurfaceKind = SurfaceKind.PLAIN
    params: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    @lru_cache(maxsize=4096)  # noqa: B019 (paints are small)
    def row(self) -> NDArray[np.float32]:
        """The paint as `SURFACE_COLUMNS` numbers, which nobody may change."""
        linear = srgb_to_linear(np.array(self.rgb) / 255.0)
        rest = (self.gloss, self.glow, float(self.kind), *self.params)
        row = np.array([*linear, *rest], dtype=np.float32)
        row.flags.writeable = False
        return row

    @classmethod
    def dye(cls, number: int, gloss: float = 0.0) -> Paint:
        """A colour that is chosen later, by `Mesh.dyed`; numbers from 1."""
        return cls((128, 128, 128), gloss, params=(float(number), 0.0, 0.0, 0.0))

    def tinted(self, factor: float) -> Paint:
        """The same paint, darker or brighter."""
        red, green, blue = (min(255.0, channel * factor) for channel in self.rgb)
        return replace(self, rgb=(red, green, blue))


def srgb_to_linear(srgb: NDArray[np.float64]) -> NDArray[np.float64]:
    """Display values 0..1 to light, by the sRGB curve."""
    bent = ((srgb + 0.055) / 1.055) ** 2.4
    return np.where(srgb <= 0.04045, srgb / 12.92, bent)


BLACK: Final = Paint((22, 22, 24))
RUBBER: Final = Paint((26, 26, 28), gloss=0.02)
CHROME: Final = Paint((150, 152, 156), gloss=0.45)
STEEL: Final = Paint((96, 100, 104), gloss=0.10)
DARK_STEEL: Final = Paint((52, 56, 60), gloss=0.08)
GLASS: Final = Paint((18, 24, 28), gloss=0.22)
WHITE_LAMP: Final = Paint((232, 236, 240), gloss=0.25, glow=0.35)
RED_LAMP: Final = Paint((176, 18, 20), gloss=0.20, glow=0.25)
AMBER_LAMP: Final = Paint((226, 120, 20), gloss=0.20, glow=0.20)
PLATE: Final = Paint((224, 222, 208))
CONCRETE: Final = Paint((150, 146, 138))


def f32(values: ArrayLike) -> Float32:
    """Numbers as single-precision numbers."""
    return np.asarray(values, dtype=np.float32)


@lru_cache(maxsize=32)
def cloudy_tile(seed: int, octaves: int = 6) -> Float32:
    """(TILE, TILE) fractal noise of mean 0 and deviation 1; tiles without a seam."""
    rng = np.random.default_rng(seed)
    total = np.zeros((TILE, TILE), dtype=np.float32)
    for octave in range(octaves):
        cells = 4 << octave
        grid = rng.standard_normal((cells, cells)).astype(np.float32)
        wrapped, scale = np.pad(grid, 2, mode="wrap"), TILE // cells
        size = len(wrapped) * scale
        large = cv2.resize(wrapped, (size, size), interpolation=cv2.INTER_CUBIC)
        inner = slice(2 * scale, -2 * scale)
        total += 0.55**octave * np.asarray(large[inner, inner])
    return np.asarray((total - total.mean()) / total.std())


@lru_cache(maxsize=32)
def grain_tile(seed: int) -> Float32:
    """(TILE, TILE) white noise of mean 0 and deviation 1."""
    rng = np.random.default_rng(seed)
    return rng.standard_normal((TILE, TILE), dtype=np.float32)


def sample(tile: Float32, u: Float32, v: Float32, per_unit: float) -> Float32:
    """The tile's value at each place (nearest), with `per_unit` texels per unit."""
    row = (v * np.float32(per_unit)).astype(np.int32) & _MASK
    column = (u * np.float32(per_unit)).astype(np.int32) & _MASK
    return np.asarray(tile.reshape(-1)[row * TILE + column])


def wrapped(values: Float32, period: Float32 | float) -> Float32:
    """The remainders, 0 up to the period: twenty times as fast as `np.mod`."""
    return np.asarray(values - period * np.floor(values / period))


def power(base: Float32, exponent: int) -> Float32:
    """`base` to a whole exponent of at least 1: many times as fast as numpy's own."""
    result = base
    for digit in f"{exponent:b}"[1:]:
        result = result * result
        if digit == "1":
            result = result * base
    return result


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


def column(values: ArrayLike) -> Float32:
    """A colour or a vector as (3, 1), for arithmetic with (3, N) and (N,)."""
    return f32(values)[:, None]


def mixed(below: Float32, above: Float32, share: Float32) -> Float32:
    """(3, N) colours blended, `share` (N,) of the one above."""
    return np.asarray(below + (above - below) * share)
