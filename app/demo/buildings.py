"""Houses: walls for the facade shader, and the parts that stand out of them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from app.demo.facade import STYLES
from app.demo.ground import SIDEWALK_HEIGHT
from app.demo.mesh import Mesh, join
from app.demo.paint import CONCRETE, DARK_STEEL, STEEL, Kind, Paint, Tag
from app.demo.solids import block, loft, sheet, tube

RGB = tuple[float, float, float]

TOWN_HOUSE, BRICK, STONE, OFFICE, FLATS, HOUSE = range(6)

WALLS: Final[dict[int, tuple[RGB, ...]]] = {
    TOWN_HOUSE: (
        (222, 206, 176),
        (206, 178, 142),
        (196, 200, 190),
        (214, 190, 178),
        (230, 222, 204),
    ),
    BRICK: ((146, 84, 64), (128, 76, 60), (158, 104, 80), (118, 82, 70)),
    STONE: ((196, 186, 166), (182, 174, 160), (206, 196, 178)),
    OFFICE: ((86, 98, 108), (70, 84, 92), (104, 112, 116)),
    FLATS: ((214, 212, 206), (198, 190, 176), (176, 188, 194)),
    HOUSE: ((232, 222, 202), (214, 196, 164), (222, 216, 210), (198, 172, 140)),
}
_ROOF_TILES: Final = Paint((134, 72, 52))
_SOFFIT: Final = Paint((206, 198, 184))
_SLATE: Final = Paint((74, 78, 86), gloss=0.02)
_AWNINGS: Final = ((150, 40, 40), (40, 78, 62), (44, 62, 104), (196, 150, 70))


@dataclass(frozen=True)
class Plot:
    """Where a house stands, and which side looks at the street.

    Attributes
    ----------
    x0, x1, y0, y1 : metres
    height : of the eaves above the ground
    style : index into `STYLES`
    front : +1 if the street lies at smaller y, -1 if at larger
    """

    x0: float
    x1: float
    y0: float
    y1: float
    height: float
    style: int
    front: int

    @property
    def street_y(self) -> float:
        """The y of the wall that looks at the street."""
        return self.y0 if self.front > 0 else self.y1


def height_of(style: int, storeys: int) -> float:
    """Eaves height that fits whole storeys."""
    rule = STYLES[style]
    return rule.base + storeys * rule.floor + 0.35


def building(plot: Plot, rng: np.random.Generator) -> Mesh:
    """A house of one of the styles, dressed as that style is."""
    walls = WALLS[plot.style]
    rgb = walls[rng.integers(len(walls))]
    seed = int(rng.integers(1, 900))
    top = plot.height + SIDEWALK_HEIGHT
    params = (plot.x0, plot.y0, float(plot.style * 1000 + seed), top)
    paint = Paint(rgb, kind=Kind.FACADE, params=params)
    body = block((plot.x0, plot.y0, 0.0), (plot.x1, plot.y1, top), paint, Tag.BUILDING)
    trim = Paint(rgb).tinted(1.12)
    if plot.style == HOUSE:
        return join([body, _gable(plot, top, Paint(rgb)), _porch(plot)])
    parts = [body, _cornice(plot, top, trim), _roof_things(plot, top, rng)]
    if plot.style in (TOWN_HOUSE, STONE, FLATS, BRICK):
        parts.append(_balconies(plot, rng))
    if plot.style in (TOWN_HOUSE, STONE) and rng.random() < 0.6:
        parts.append(_mansard(plot, top))
    if plot.style in (TOWN_HOUSE, BRICK, STONE) and rng.random() < 0.75:
        parts.append(_awnings(plot, rng))
    return join(parts)


def _cornice(plot: Plot, top: float, trim: Paint) -> Mesh:
    out = 0.35 if plot.style != OFFICE else 0.12
    thick = 0.42 if plot.style != OFFICE else 0.25
    roof = block(
        (plot.x0 - out, plot.y0 - out, top - thick),
        (plot.x1 + out, plot.y1 + out, top),
        trim,
        Tag.BUILDING,
    )
    parapet = block(
        (plot.x0, plot.y0, top),
        (plot.x1, plot.y1, top + 0.6),
        trim.tinted(0.92),
        Tag.BUILDING,
    )
    return join([roof, parapet])


def _roof_things(plot: Plot, top: float, rng: np.random.Generator) -> Mesh:
    parts = []
    for _ in range(int(rng.integers(2, 5))):
        x = float(rng.uniform(plot.x0 + 1.5, plot.x1 - 1.5))
        y = float(rng.uniform(plot.y0 + 1.5, plot.y1 - 1.5))
        wide, tall = float(rng.uniform(0.5, 1.3)), float(rng.uniform(1.3, 2.6))
        paint = CONCRETE if rng.random() < 0.5 else Paint((120, 70, 54))
        parts.append(
            block(
                (x - wide, y - wide, top),
                (x + wide, y + wide, top + tall),
                paint,
                Tag.BUILDING,
            )
        )
    return join(parts)


def _mansard(plot: Plot, top: float) -> Mesh:
    low = np.array(
        [(plot.x0, plot.y0), (plot.x1, plot.y0), (plot.x1, plot.y1), (plot.x0, plot.y1)]
    )
    inset = np.array([(1.5, 1.5), (-1.5, 1.5), (-1.5, -1.5), (1.5, -1.5)])
    rings = np.stack(
        [
            np.column_stack([low, np.full(4, top)]),
            np.column_stack([low + inset, np.full(4, top + 3.0)]),
        ]
    )
    roof = loft(rings, [[_SLATE]], Tag.BUILDING)
    bay = STYLES[plot.style].bay
    dormers = []
    y = plot.street_y + 0.45 * plot.front
    for x in np.arange(plot.x0 + bay * 1.5, plot.x1 - bay, bay * 2):
        lo, hi = sorted((y, y + 1.4 * plot.front))
        dormers.append(
            block(
                (x - 0.65, lo, top),
                (x + 0.65, hi, top + 2.0),
                CONCRETE.tinted(1.2),
                Tag.BUILDING,
            )
        )
        pane = sorted((y - 0.02 * plot.front, y))
        glass = Paint((26, 32, 38), gloss=0.2)
        dormers.append(
            block(
                (x - 0.45, pane[0], top + 0.5),
                (x + 0.45, pane[1], top + 1.75),
                glass,
                Tag.BUILDING,
            )
        )
    return join([roof, *dormers])


def _balconies(plot: Plot, rng: np.random.Generator) -> Mesh:
    rule = STYLES[plot.style]
    bays = int((plot.x1 - plot.x0) / rule.bay)
    storeys = int((plot.height - rule.base) / rule.floor)
    chance = {FLATS: 0.55, TOWN_HOUSE: 0.22, STONE: 0.25}.get(plot.style, 0.10)
    columns = [bay for bay in range(bays) if rng.random() < chance]
    first = 1 if plot.style != FLATS else 0
    half = min(rule.width / 2 + 0.3, rule.bay / 2 - 0.1)
    places = [
        (
            plot.x0 + (bay + 0.5) * rule.bay,
            plot.street_y,
            SIDEWALK_HEIGHT + rule.base + storey * rule.floor,
        )
        for bay in columns
        for storey in range(first, storeys)
    ]
    template = _balcony(plot.style, plot.front, half)
    return template.repeated(np.array(places).reshape(-1, 3))


@lru_cache(maxsize=32)
def _balcony(style: int, front: int, half: float) -> Mesh:
    """A balcony before a wall at y = 0, its floor at z = 0."""
    out = -1.05 * front
    lo, hi = sorted((0.0, out))
    slab = block((-half, lo, -0.14), (half, hi, 0), CONCRETE.tinted(1.2), Tag.BUILDING)
    if style == FLATS:
        edge = sorted((out, out + 0.05 * front))
        pane = Paint((150, 164, 168), gloss=0.12)
        pane_mesh = block(
            (-half, edge[0], 0), (half, edge[1], 0.95), pane, Tag.BUILDING
        )
        return join([slab, pane_mesh])
    rail = (DARK_STEEL, Tag.BUILDING)
    edge_y = out + 0.06 * front
    along = np.arange(-half + 0.05, half, 0.17)
    places = np.column_stack([along, np.full(len(along), edge_y), np.zeros(len(along))])
    bars = tube((0, 0, 0), (0, 0, 0.95), 0.014, rail, 3).repeated(places)
    top = tube((-half, edge_y, 0.97), (half, edge_y, 0.97), 0.03, rail, 4)
    sides = [
        tube((at, 0, 0.97), (at, edge_y, 0.97), 0.025, rail, 4) for at in (-half, half)
    ]
    return join([slab, bars, top, *sides])


def _awnings(plot: Plot, rng: np.random.Generator) -> Mesh:
    rule = STYLES[plot.style]
    color = _AWNINGS[rng.integers(len(_AWNINGS))]
    wall, out = plot.street_y - 0.02 * plot.front, plot.street_y - 1.3 * plot.front
    parts = []
    for bay in range(int((plot.x1 - plot.x0) / rule.bay)):
        if rng.random() < 0.45:
            continue
        x0 = plot.x0 + (bay + 0.08) * rule.bay
        x1 = plot.x0 + (bay + 0.92) * rule.bay
        high, low = 3.25, 2.72
        stripes = np.linspace(x0, x1, 7)
        for index, (a, b) in enumerate(itertools.pairwise(stripes)):
            paint = Paint(color) if index % 2 else Paint((226, 220, 206))
            slope = [(a, wall, high), (b, wall, high), (b, out, low), (a, out, low)]
            fall = [
                (a, out, low),
                (b, out, low),
                (b, out, low - 0.22),
                (a, out, low - 0.22),
            ]
            parts.append(sheet(slope, (0, -0.4 * plot.front, 1), paint, Tag.BUILDING))
            parts.append(
                sheet(slope, (0, 0.4 * plot.front, -1), paint.tinted(0.6), Tag.BUILDING)
            )
            parts.append(sheet(fall, (0, -plot.front, 0), paint, Tag.BUILDING))
            parts.append(
                sheet(fall, (0, plot.front, 0), paint.tinted(0.6), Tag.BUILDING)
            )
    sign = sorted((wall, wall - 0.12 * plot.front))
    fascia = Paint(color).tinted(0.8)
    parts.append(
        block(
            (plot.x0 + 0.3, sign[0], 3.3),
            (plot.x1 - 0.3, sign[1], 3.85),
            fascia,
            Tag.BUILDING,
        )
    )
    return join(parts)


def _gable(plot: Plot, top: float, wall: Paint) -> Mesh:
    """A tiled roof with its ridge along the street, and the gable walls under it."""
    out, rise = 0.45, 0.36 * (plot.y1 - plot.y0)
    ridge = (plot.y0 + plot.y1) / 2
    x0, x1 = plot.x0 - out, plot.x1 + out
    parts = []
    for y, sign in ((plot.y0 - out, -1.0), (plot.y1 + out, 1.0)):
        low = top - 0.16
        corners = [
            (x0, y, low),
            (x1, y, low),
            (x1, ridge, top + rise),
            (x0, ridge, top + rise),
        ]
        parts.append(sheet(corners, (0, sign * 0.6, 0.8), _ROOF_TILES, Tag.BUILDING))
        under = [(x, at, z - 0.12) for x, at, z in corners]
        parts.append(sheet(under, (0, -sign * 0.6, -0.8), _SOFFIT, Tag.BUILDING))
    for x, sign in ((plot.x0, -1.0), (plot.x1, 1.0)):
        gable = [
            (x, plot.y0, top),
            (x, plot.y1, top),
            (x, ridge, top + rise - 0.1),
            (x, ridge, top + rise - 0.1),
        ]
        parts.append(sheet(gable, (sign, 0, 0), wall, Tag.BUILDING))
    chimney_x = plot.x0 + 0.3 * (plot.x1 - plot.x0)
    chimney = block(
        (chimney_x, ridge + 0.8, top + rise * 0.4),
        (chimney_x + 0.7, ridge + 1.5, top + rise + 0.9),
        Paint((128, 78, 62)),
        Tag.BUILDING,
    )
    return join([*parts, chimney])


def _porch(plot: Plot) -> Mesh:
    middle = (plot.x0 + plot.x1) / 2
    lo, hi = sorted((plot.street_y, plot.street_y - 0.06 * plot.front))
    door = block(
        (middle - 0.55, lo, 0.1),
        (middle + 0.55, hi, 2.35),
        Paint((92, 54, 38), gloss=0.03),
        Tag.BUILDING,
    )
    lo, hi = sorted((plot.street_y, plot.street_y - 1.3 * plot.front))
    roof = block((middle - 1.0, lo, 2.6), (middle + 1.0, hi, 2.72), STEEL, Tag.BUILDING)
    return join([door, roof])
