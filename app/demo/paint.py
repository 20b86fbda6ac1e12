"""What a triangle is made of, and CARLA's tags for it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from filter_core.segmentation.palettes import palette_of

FAMILY: Final = "carla-0.9.14"
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


class Kind(IntEnum):
    """How a surface is shaded; PLAIN is one colour."""

    PLAIN = 0
    LEAF = 1
    FACADE = 2
    MASONRY = 3
    PAVING = 4
    GRASS = 5


SURFACE_COLUMNS: Final = 10
"""red, green, blue (linear), gloss, glow, kind, four parameters of the kind."""


DYE_COLUMN: Final = 6
"""The first parameter: of a plain surface, the number of its dye, or 0."""


@dataclass(frozen=True)
class Paint:
    """The look of a surface.

    Attributes
    ----------
    rgb : sRGB, 0..255
    gloss : 0..1, the share of light mirrored when looking straight on
    glow : light given off, in multiples of the colour
    kind : `Kind`
    params : what the kind's shader needs
    """

    rgb: tuple[float, float, float]
    gloss: float = 0.0
    glow: float = 0.0
    kind: Kind = Kind.PLAIN
    params: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    def row(self) -> NDArray[np.float32]:
        """The paint as `SURFACE_COLUMNS` numbers."""
        linear = srgb_to_linear(np.array(self.rgb) / 255.0)
        rest = (self.gloss, self.glow, float(self.kind), *self.params)
        return np.array([*linear, *rest], dtype=np.float32)

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
