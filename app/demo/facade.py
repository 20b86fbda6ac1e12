"""Walls with windows, drawn per pixel from the place on the wall."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from numpy.typing import NDArray

from app.demo.textures import (
    Float32,
    cloudy_tile,
    coverage,
    f32,
    grain_tile,
    hashed,
    mixed,
    sample,
)


@dataclass(frozen=True)
class FacadeStyle:
    """How a wall is divided; metres.

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


STYLES: Final = (
    FacadeStyle(3.0, 3.4, 4.2, 1.25, 1.95, 0.75, 0.0, 2, 0.16, 0.0),  # town house
    FacadeStyle(3.2, 3.2, 4.0, 1.70, 1.65, 0.90, 1.0, 3, 0.10, 0.0),  # brick
    FacadeStyle(2.6, 3.6, 4.4, 1.05, 2.25, 0.55, 0.25, 2, 0.20, 0.0),  # stone
    FacadeStyle(1.6, 3.5, 4.6, 1.44, 2.60, 0.55, 0.0, 1, 0.04, 1.0),  # office
    FacadeStyle(4.0, 3.1, 3.8, 2.90, 1.55, 0.95, 0.0, 4, 0.06, 0.0),  # flats
    FacadeStyle(2.8, 2.9, 0.0, 1.20, 1.30, 0.90, 0.0, 2, 0.12, 0.0),  # house
)
_TABLE: Final = {
    field.name: np.array([getattr(s, field.name) for s in STYLES], dtype=np.float32)
    for field in fields(FacadeStyle)
}


@dataclass(frozen=True, eq=False)
class WallPixels:
    """What the shader needs of each of N pixels.

    Attributes
    ----------
    position, normal : (N, 3) world
    albedo : (N, 3) linear, the wall's own colour
    params : (N, 4) the paint's: where x and y axes start, style and seed, roof height
    footprint : (N,) metres per pixel, upright and across
    """

    position: Float32
    normal: Float32
    albedo: Float32
    params: Float32
    footprint: tuple[Float32, Float32]


@dataclass(frozen=True, eq=False)
class WallLook:
    """What comes out: colour, mirror share, own light, and light kept in recesses."""

    albedo: Float32
    gloss: Float32
    glow: Float32
    open_sky: Float32
    tilt: Float32


def facade_look(wall: WallPixels) -> WallLook:
    """Windows, frames, sills, floors and shops of facade pixels."""
    style_and_seed = wall.params[:, 2].astype(np.int32)
    style, seed = style_and_seed // 1000, style_and_seed % 1000
    facing_x = np.abs(wall.normal[:, 0]) > np.abs(wall.normal[:, 1])
    u = np.where(
        facing_x,
        wall.position[:, 1] - wall.params[:, 1],
        wall.position[:, 0] - wall.params[:, 0],
    )
    return _Wall(wall, style, seed + 7 * facing_x, u).look()


class _Wall:
    """One evaluation of the shader; the steps share many intermediate planes."""

    def __init__(
        self,
        wall: WallPixels,
        style: NDArray[np.int32],
        seed: NDArray[np.int32],
        u: Float32,
    ) -> None:
        self._wall, self._seed, self._u = wall, seed, u
        self._z = wall.position[:, 2]
        self._up, self._across = wall.footprint
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

    def look(self) -> WallLook:
        """The whole look; later layers lie on top of earlier ones."""
        of = self._of
        albedo, open_sky = self._bare_wall()
        half_width, half_height, middle = self._opening()
        du = half_width - np.abs(self._in_bay)
        dv = half_height - np.abs(self._in_storey - middle)
        # No window where the roof would cut it, nor below ground.
        fits = self._z - self._in_storey + of["floor"] <= self._wall.params[:, 3] + 0.3
        fits |= self._shop
        frame = coverage(du + of["trim"], self._across) * coverage(
            dv + of["trim"], self._up
        )
        glass = coverage(du, self._across) * coverage(dv, self._up) * fits
        trim_color = np.clip(self._wall.albedo * 1.22 + 0.03, 0, 0.86)
        albedo = mixed(albedo, trim_color, frame * fits * (1 - of["glass"]))
        shade = np.where(fits, self._sill_shadow(du, dv), np.float32(1))
        bars = self._bars(du, dv)
        pane, glow = self._behind_glass(dv)
        albedo = mixed(albedo, pane, glass * (1 - bars))
        bar_color = np.where(
            (self._dice > 0.5)[:, None], np.float32(0.62), np.float32(0.09)
        )
        albedo = mixed(albedo, np.broadcast_to(bar_color, albedo.shape), glass * bars)
        reveal = self._reveal(du, dv, glass)
        gloss = 0.13 * glass * (1 - bars) * (1 + 0.8 * of["glass"])
        tilt = (self._dice - 0.5) * 0.05 * glass
        return WallLook(albedo, gloss, glow * glass, open_sky * shade * reveal, tilt)

    def _opening(self) -> tuple[Float32, Float32, Float32]:
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
        albedo = self._wall.albedo * (1 + stain + grain)[:, None]
        course = np.floor(z / 0.09).astype(np.int32)
        brick = np.floor(u / 0.25 + 0.5 * (course & 1).astype(np.float32)).astype(
            np.int32
        )
        tone = (hashed(brick, course) - 0.5) * 0.42 * near
        joint = np.minimum(np.mod(z, 0.09), 0.09 - np.mod(z, 0.09)) < 0.008
        albedo *= (1 + of["bricks"] * (tone + 0.30 * joint * near))[:, None]
        band = coverage(0.11 - np.abs(self._in_storey), self._up) * (of["glass"] < 0.5)
        albedo = albedo * (1 + 0.16 * band)[:, None]
        dirt = np.clip(1 - z / 1.4, 0, 1) * 0.22
        return albedo * (1 - dirt)[:, None], np.ones_like(u)

    def _sill_shadow(self, du: Float32, dv: Float32) -> Float32:
        """The dark line under a window sill."""
        below = (self._in_storey < self._of["sill"]) & ~self._shop
        depth = np.clip((-dv - self._of["trim"]) / 0.22, 0, 1)
        near = coverage(du + self._of["trim"] + 0.05, self._across)
        return 1 - 0.34 * near * np.where(below, 1 - depth, 0) * (
            dv < -self._of["trim"]
        )

    def _bars(self, du: Float32, dv: Float32) -> Float32:
        """Glazing bars: the casement, its upright divisions, and a transom."""
        of = self._of
        half_width, half_height, middle = self._opening()
        panes = np.where(self._shop, 2, of["panes"])
        pane = 2 * half_width / panes
        position = np.mod(self._in_bay + half_width, pane)
        upright = 0.035 - np.minimum(position, pane - position)
        casement = 0.055 - np.minimum(du, dv)
        transom = 0.03 - np.abs(self._in_storey - middle - half_height * 0.42)
        bars = np.maximum(coverage(upright, self._across), coverage(transom, self._up))
        return np.maximum(bars, coverage(casement, np.maximum(self._across, self._up)))

    def _behind_glass(self, dv: Float32) -> tuple[Float32, Float32]:
        """Dark rooms, curtains and blinds, some lights; wares in shops."""
        dice = self._dice
        room = f32([0.020, 0.024, 0.028]) * (0.5 + 1.5 * dice)[:, None]
        drawn = hashed(self._bay, self._storey, self._seed + 31)
        down = 2 * self._opening()[1] * np.clip(drawn * 1.5 - 0.55, 0, 1)
        from_top = self._opening()[1] - (self._in_storey - self._opening()[2])
        curtain = coverage(down - from_top, self._up) * 0.9
        cloth = f32([0.46, 0.42, 0.36]) * (0.55 + 0.6 * dice)[:, None]
        pane = mixed(room, cloth.astype(np.float32), curtain * ~self._shop)
        lit = (dice > 0.93) | (self._shop & (dice > 0.35))
        warm = f32([0.62, 0.40, 0.19])
        wares = sample(cloudy_tile(9), self._u, self._z, 70.0) * 0.14 + 0.42
        pane = np.where((lit & ~self._shop)[:, None], pane + warm * 0.35, pane)
        pane = np.where((lit & self._shop)[:, None], warm * wares[:, None] * 0.6, pane)
        return pane.astype(np.float32), np.where(lit, np.float32(0.35), np.float32(0.0))

    def _reveal(self, du: Float32, dv: Float32, glass: Float32) -> Float32:
        """Windows lie behind the wall: their upper and one side edge are in shade."""
        half_height, middle = self._opening()[1], self._opening()[2]
        from_top = half_height - (self._in_storey - middle)
        from_side = self._in_bay + self._opening()[0]
        top = np.clip(1 - from_top / 0.22, 0, 1)
        side = np.clip(1 - from_side / 0.14, 0, 1)
        return np.asarray(1 - 0.62 * np.maximum(top, side) * glass)
