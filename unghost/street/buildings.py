"""Houses: their shape as triangles, and their walls with windows, drawn per pixel.

`building` makes the walls, roof, balconies and cornices as triangles. `Walls` colours
the pixels of walls: it draws windows, frames, sills and shops from the place of each
pixel on its wall. Both follow the same `FACADE_STYLES`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Final

import numpy as np

from unghost.street.ground import SIDEWALK_HEIGHT
from unghost.street.mesh import Block, Mesh, block, blocks, join, loft, sheet, tube
from unghost.street.paint import (
    CONCRETE,
    DARK_STEEL,
    RGB,
    STEEL,
    Float32,
    Paint,
    SurfaceKind,
    Tag,
    cloudy_tile,
    column,
    coverage,
    grain_tile,
    hashed,
    mixed,
    sample,
    wrapped,
)

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
class FacadeStyle:
    """How the wall of a house is divided into windows and storeys. Lengths in metres.

    Attributes
    ----------
    bay, floor : width of a window axis, height of a storey
    base : height of the ground floor; 0 if it is like the others
    width, height, sill : of a window, and its height above the floor
    bricks : 0..1, how visible the courses are
    panes : columns of panes in a window
    trim : width of the frame around a window
    glass : 0..1, how much the wall itself is a mirror
    """

    bay: float
    floor: float
    base: float
    width: float
    height: float
    sill: float
    bricks: float
    panes: float
    trim: float
    glass: float


FACADE_STYLES: Final = (
    FacadeStyle(3.0, 3.4, 4.2, 1.25, 1.95, 0.75, 0.0, 2, 0.16, 0.0),  # town house
    FacadeStyle(3.2, 3.2, 4.0, 1.70, 1.65, 0.90, 1.0, 3, 0.10, 0.0),  # brick
    FacadeStyle(2.6, 3.6, 4.4, 1.05, 2.25, 0.55, 0.25, 2, 0.20, 0.0),  # stone
    FacadeStyle(1.6, 3.5, 4.6, 1.44, 2.60, 0.55, 0.0, 1, 0.04, 1.0),  # office
    FacadeStyle(4.0, 3.1, 3.8, 2.90, 1.55, 0.95, 0.0, 4, 0.06, 0.0),  # flats
    FacadeStyle(2.8, 2.9, 0.0, 1.20, 1.30, 0.90, 0.0, 2, 0.12, 0.0),  # house
)
_TABLE: Final = {
    field.name: np.array(
        [getattr(s, field.name) for s in FACADE_STYLES], dtype=np.float32
    )
    for field in fields(FacadeStyle)
}


@dataclass(frozen=True)
class Plot:
    """Where a house stands, and which side looks at the street.

    `height` is that of the eaves above the ground, metres, as the others; `style` an
    index into `FACADE_STYLES`; `front` +1 if the street lies at smaller y, -1 if at
    larger.
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
    """The height of the eaves above the ground, metres, for so many storeys."""
    rule = FACADE_STYLES[style]
    return rule.base + storeys * rule.floor + 0.35


def building(plot: Plot, rng: np.random.Generator) -> Mesh:
    """The triangles of a house on its plot, with what its style adds to the walls."""
    walls = WALLS[plot.style]
    rgb = walls[rng.integers(len(walls))]
    seed = int(rng.integers(1, 900))
    top = plot.height + SIDEWALK_HEIGHT
    params = (plot.x0, plot.y0, float(plot.style * 1000 + seed), top)
    paint = Paint(rgb, kind=SurfaceKind.FACADE, params=params)
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
    out, thick = (0.12, 0.25) if plot.style == OFFICE else (0.35, 0.42)
    x0, x1, y0, y1 = plot.x0, plot.x1, plot.y0, plot.y1
    parapet = trim.tinted(0.92)
    rows = [
        ((x0 - out, y0 - out, top - thick), (x1 + out, y1 + out, top), trim),
        ((x0, y0, top), (x1, y1, top + 0.6), parapet),
    ]
    return blocks(rows, Tag.BUILDING)


def _roof_things(plot: Plot, top: float, rng: np.random.Generator) -> Mesh:
    rows = []
    for _ in range(int(rng.integers(2, 5))):
        x = float(rng.uniform(plot.x0 + 1.5, plot.x1 - 1.5))
        y = float(rng.uniform(plot.y0 + 1.5, plot.y1 - 1.5))
        wide, tall = float(rng.uniform(0.5, 1.3)), float(rng.uniform(1.3, 2.6))
        paint = CONCRETE if rng.random() < 0.5 else Paint((120, 70, 54))
        high = (x + wide, y + wide, top + tall)
        rows.append(((x - wide, y - wide, top), high, paint))
    return blocks(rows, Tag.BUILDING)


def _mansard(plot: Plot, top: float) -> Mesh:
    x0, x1, y0, y1, front = plot.x0, plot.x1, plot.y0, plot.y1, plot.front
    low = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    inset = np.array([(1.5, 1.5), (-1.5, 1.5), (-1.5, -1.5), (1.5, -1.5)])
    rings = np.stack(
        [
            np.column_stack([low, np.full(4, top)]),
            np.column_stack([low + inset, np.full(4, top + 3.0)]),
        ]
    )
    wall, glass = CONCRETE.tinted(1.2), Paint((26, 32, 38), gloss=0.2)
    bay = FACADE_STYLES[plot.style].bay
    y = plot.street_y + 0.45 * front
    near, far = sorted((y, y + 1.4 * front))
    out, flush = sorted((y - 0.02 * front, y))
    dormers: list[Block] = []
    for x in np.arange(x0 + bay * 1.5, x1 - bay, bay * 2):
        dormers += [
            ((x - 0.65, near, top), (x + 0.65, far, top + 2.0), wall),
            ((x - 0.45, out, top + 0.5), (x + 0.45, flush, top + 1.75), glass),
        ]
    return join([loft(rings, [[_SLATE]], Tag.BUILDING), blocks(dormers, Tag.BUILDING)])


def _balconies(plot: Plot, rng: np.random.Generator) -> Mesh:
    rule = FACADE_STYLES[plot.style]
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
    rule, front = FACADE_STYLES[plot.style], plot.front
    color = _AWNINGS[rng.integers(len(_AWNINGS))]
    wall, out = plot.street_y - 0.02 * front, plot.street_y - 1.3 * front
    high, low, hem = 3.25, 2.72, 2.72 - 0.22
    bays = range(int((plot.x1 - plot.x0) / rule.bay))
    shops = [plot.x0 + bay * rule.bay for bay in bays if rng.random() >= 0.45]
    parts = []
    for first, paint in enumerate((Paint((226, 220, 206)), Paint(color))):
        stripes = [
            (x + left * rule.bay, x + (left + 0.14) * rule.bay)
            for x in shops
            for left in (0.08 + 0.14 * index for index in range(first, 6, 2))
        ]
        slopes = [
            [(a, wall, high), (b, wall, high), (b, out, low), (a, out, low)]
            for a, b in stripes
        ]
        falls = [
            [(a, out, low), (b, out, low), (b, out, hem), (a, out, hem)]
            for a, b in stripes
        ]
        lining = paint.tinted(0.6)
        parts += [
            sheet(slopes, (0, -0.4 * front, 1), paint, Tag.BUILDING),
            sheet(slopes, (0, 0.4 * front, -1), lining, Tag.BUILDING),
            sheet(falls, (0, -front, 0), paint, Tag.BUILDING),
            sheet(falls, (0, front, 0), lining, Tag.BUILDING),
        ]
    near, far = sorted((wall, wall - 0.12 * front))
    fascia = Paint(color).tinted(0.8)
    low_end, high_end = (plot.x0 + 0.3, near, 3.3), (plot.x1 - 0.3, far, 3.85)
    return join([*parts, block(low_end, high_end, fascia, Tag.BUILDING)])


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
    middle, wall = (plot.x0 + plot.x1) / 2, plot.street_y
    near, far = sorted((wall, wall - 0.06 * plot.front))
    begin, end = sorted((wall, wall - 1.3 * plot.front))
    door = Paint((92, 54, 38), gloss=0.03)
    rows = [
        ((middle - 0.55, near, 0.1), (middle + 0.55, far, 2.35), door),
        ((middle - 1.0, begin, 2.6), (middle + 1.0, end, 2.72), STEEL),
    ]
    return blocks(rows, Tag.BUILDING)


class Walls:
    """Windows, frames, sills, floors and shops of N pixels of walls.

    Parameters
    ----------
    position, normal : (3, N) world
    albedo : (3, N) linear, the wall's own colour
    params : (4, N) the paint's: where x and y axes start, style and seed, roof height
    footprint : (N,) metres per pixel, upright and across
    """

    def __init__(
        self,
        position: Float32,
        normal: Float32,
        albedo: Float32,
        params: Float32,
        footprint: tuple[Float32, Float32],
    ) -> None:
        self._albedo, self._roof = albedo, params[3]
        style_and_seed = params[2].astype(np.int32)
        style, seed = style_and_seed // 1000, style_and_seed % 1000
        facing_x = np.abs(normal[0]) > np.abs(normal[1])
        along_x, along_y = (position[axis] - params[axis] for axis in (0, 1))
        u = np.where(facing_x, along_y, along_x)
        seed = seed + 7 * facing_x
        self._seed, self._u = seed, u
        self._z = position[2]
        self._up, self._across = footprint
        self._of = {name: column[style] for name, column in _TABLE.items()}
        of = self._of
        # Whole numbers stay float32 here: int32 times float32 would be float64.
        bay = np.floor(u / of["bay"])
        self._bay = bay.astype(np.int32)
        self._in_bay = u - (bay + np.float32(0.5)) * of["bay"]
        above = self._z - of["base"]
        storey = np.floor(above / of["floor"])
        self._storey = storey.astype(np.int32)
        self._in_storey = above - storey * of["floor"]
        self._shop = (self._storey < 0) & (of["base"] > 0)
        self._dice = hashed(self._bay, self._storey, seed)
        self._opening = self._window()

    def look(self) -> tuple[Float32, Float32, Float32, Float32, Float32]:
        """Colours, shares of mirrored light, own light, open sky, tilt of the glass.

        Later layers lie on top of earlier ones.
        """
        of = self._of
        albedo, open_sky = self._bare_wall()
        half_width, half_height, middle = self._opening
        du = half_width - np.abs(self._in_bay)
        dv = half_height - np.abs(self._in_storey - middle)
        # No window where the roof would cut it, nor below ground.
        fits = self._z - self._in_storey + of["floor"] <= self._roof + 0.3
        fits |= self._shop
        frame = coverage(du + of["trim"], self._across) * coverage(
            dv + of["trim"], self._up
        )
        glass = coverage(du, self._across) * coverage(dv, self._up) * fits
        trim_color = np.clip(self._albedo * 1.22 + 0.03, 0, 0.86)
        albedo = mixed(albedo, trim_color, frame * fits * (1 - of["glass"]))
        shade = np.where(fits, self._sill_shadow(du, dv), np.float32(1))
        bars = self._bars(du, dv)
        pane, glow = self._behind_glass(dv)
        albedo = mixed(albedo, pane, glass * (1 - bars))
        bar_gray = np.where(self._dice > 0.5, np.float32(0.62), np.float32(0.09))
        albedo = mixed(albedo, bar_gray, glass * bars)
        reveal = self._reveal(du, dv, glass)
        gloss = 0.13 * glass * (1 - bars) * (1 + 0.8 * of["glass"])
        tilt = (self._dice - 0.5) * 0.05 * glass
        return albedo, gloss, glow * glass, open_sky * shade * reveal, tilt

    def _window(self) -> tuple[Float32, Float32, Float32]:
        """Half the width and the height of each window, and the middle's height."""
        of = self._of
        half_width = np.where(self._shop, of["bay"] * 0.43, of["width"] / 2)
        half_height = np.where(self._shop, of["base"] * 0.34, of["height"] / 2)
        # The ground floor counts from its own top: storey -1 spans one storey height.
        lift = of["floor"] - of["base"]
        middle = np.where(
            self._shop, lift + of["base"] * 0.44, of["sill"] + of["height"] / 2
        )
        return half_width, half_height, middle

    def _bare_wall(self) -> tuple[Float32, Float32]:
        of, u, z = self._of, self._u, self._z
        near = 1 / (1 + (self._up * 45) ** 2)
        stain = sample(cloudy_tile(3), u, z, 14.0) * 0.045
        stain += sample(cloudy_tile(5), u * 3, z * 0.6, 9.0) * 0.030
        grain = sample(grain_tile(7), u, z, 60.0) * 0.05 * near
        albedo = self._albedo * (1 + stain + grain)
        course = np.floor(z / 0.09).astype(np.int32)
        brick = np.floor(u / 0.25 + 0.5 * (course & 1).astype(np.float32)).astype(
            np.int32
        )
        tone = (hashed(brick, course) - 0.5) * 0.42 * near
        joint = np.minimum(wrapped(z, 0.09), 0.09 - wrapped(z, 0.09)) < 0.008
        albedo *= 1 + of["bricks"] * (tone + 0.30 * joint * near)
        band = coverage(0.11 - np.abs(self._in_storey), self._up) * (of["glass"] < 0.5)
        albedo = albedo * (1 + 0.16 * band)
        dirt = np.clip(1 - z / 1.4, 0, 1) * 0.22
        return albedo * (1 - dirt), np.ones_like(u)

    def _sill_shadow(self, du: Float32, dv: Float32) -> Float32:
        """The dark line under a window sill."""
        below = (self._in_storey < self._of["sill"]) & ~self._shop
        depth = np.clip((-dv - self._of["trim"]) / 0.22, 0, 1)
        near = coverage(du + self._of["trim"] + 0.05, self._across)
        is_under = below & (dv < -self._of["trim"])
        return np.asarray(1 - 0.34 * near * (1 - depth) * is_under)

    def _bars(self, du: Float32, dv: Float32) -> Float32:
        """Glazing bars: the casement, its upright divisions, and a transom."""
        of = self._of
        half_width, half_height, middle = self._opening
        panes = np.where(self._shop, 2, of["panes"])
        pane = 2 * half_width / panes
        position = wrapped(self._in_bay + half_width, pane)
        upright = 0.035 - np.minimum(position, pane - position)
        casement = 0.055 - np.minimum(du, dv)
        transom = 0.03 - np.abs(self._in_storey - middle - half_height * 0.42)
        bars = np.maximum(coverage(upright, self._across), coverage(transom, self._up))
        return np.maximum(bars, coverage(casement, np.maximum(self._across, self._up)))

    def _behind_glass(self, dv: Float32) -> tuple[Float32, Float32]:
        """Dark rooms, curtains and blinds, some lights; wares in shops."""
        dice = self._dice
        room = column([0.020, 0.024, 0.028]) * (0.5 + 1.5 * dice)
        drawn = hashed(self._bay, self._storey, self._seed + 31)
        down = 2 * self._opening[1] * np.clip(drawn * 1.5 - 0.55, 0, 1)
        from_top = self._opening[1] - (self._in_storey - self._opening[2])
        curtain = coverage(down - from_top, self._up) * 0.9
        cloth = column([0.46, 0.42, 0.36]) * (0.55 + 0.6 * dice)
        pane = mixed(room, cloth, curtain * ~self._shop)
        lit = (dice > 0.93) | (self._shop & (dice > 0.35))
        warm = column([0.62, 0.40, 0.19])
        wares = sample(cloudy_tile(9), self._u, self._z, 70.0) * 0.14 + 0.42
        pane = np.where(lit & ~self._shop, pane + warm * 0.35, pane)
        pane = np.where(lit & self._shop, warm * wares * 0.6, pane)
        return np.asarray(pane), np.where(lit, np.float32(0.35), np.float32(0.0))

    def _reveal(self, du: Float32, dv: Float32, glass: Float32) -> Float32:
        """Windows lie behind the wall: their upper and one side edge are in shade."""
        half_height, middle = self._opening[1], self._opening[2]
        from_top = half_height - (self._in_storey - middle)
        from_side = self._in_bay + self._opening[0]
        top = np.clip(1 - from_top / 0.22, 0, 1)
        side = np.clip(1 - from_side / 0.14, 0, 1)
        return np.asarray(1 - 0.62 * np.maximum(top, side) * glass)
