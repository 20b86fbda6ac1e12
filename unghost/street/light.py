"""Light: the sun and the sky at an hour, shadows, and the shading of surfaces.

`shade` computes the light that reaches the camera from N pixels that show a surface.
`develop` turns light into an image for a display. A `ShadowMap` says which surface is
nearest to the sun; what lies behind it is in shadow.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import FloatArray
from unghost.street.buildings import Walls
from unghost.street.ground import grass, ground_footprint, paving
from unghost.street.mesh import Mesh, along, dot, join, turned
from unghost.street.paint import (
    RGB,
    TILE,
    Float32,
    SurfaceKind,
    cloudy_tile,
    column,
    f32,
    mixed,
    power,
    sample,
    wrapped,
)
from unghost.street.raster import Canvas, draw

_LOWEST: Final = -1e6
_MESHES_AT_ONCE: Final = 32
_BIAS: Final = 0.06
"""Metres that a surface may lie under the map without being in its own shadow."""
_TAPS: Final = ((-0.7, -0.3), (0.3, -0.7), (0.7, 0.3), (-0.3, 0.7))


@dataclass(frozen=True)
class Daylight:
    """Light in linear units; the sun's direction points towards the sun.

    Attributes
    ----------
    sun : (x, y, z), unit length
    sunlight, zenith, horizon, bounce : light of the sun, the sky, and from the ground
    haze : share of the view lost per metre
    clouds : 0..1
    exposure : the factor of the camera
    """

    sun: RGB
    sunlight: RGB
    zenith: RGB
    horizon: RGB
    bounce: RGB
    haze: float
    clouds: float
    exposure: float


@dataclass(frozen=True, eq=False)
class Lighting:
    """The lighting of a frame."""

    daylight: Daylight
    shadows: tuple[ShadowMap, ...]


@dataclass(frozen=True, eq=False)
class Pixels:
    """N pixels that show a surface: its position and its material.

    Each row of an array is one quantity of all pixels: numpy is many times slower where
    the last axis has three numbers.

    Attributes
    ----------
    position, direction, normal : (3, N), of the world; metres, and unit lengths
    distance, metres_per_pixel : (N,)
    surface : (SURFACE_COLUMNS, N)
    """

    position: Float32
    direction: Float32
    distance: Float32
    normal: Float32
    surface: Float32
    metres_per_pixel: Float32


@dataclass(eq=False)
class Look:
    """The values of each pixel that depend on the kind of surface."""

    albedo: Float32
    gloss: Float32
    glow: Float32
    open_sky: Float32
    normal: Float32


def shade(pixels: Pixels, open_sky: Float32, light: Lighting) -> Float32:
    """(3, N) linear light that reaches the camera, haze included."""
    look = _looks(pixels)
    look.open_sky = look.open_sky * open_sky
    leaf = pixels.surface[5] == SurfaceKind.LEAF
    diffuse = look.albedo * _irradiance(pixels, look, leaf, light)
    shiny = np.flatnonzero(look.gloss > 0)
    diffuse[:, shiny] = _with_mirror(pixels, look, diffuse, shiny, light.daylight)
    diffuse += look.albedo * (look.glow * np.float32(2.0))
    level = pixels.direction.copy()
    level[2] = np.abs(level[2]) * 0.3 + 0.01
    air = sky_light(light.daylight, level) * 0.92
    depth = pixels.distance * light.daylight.haze
    share = 1 - np.exp(-depth * np.sqrt(np.sqrt(depth)))
    hazed: Float32 = diffuse + (air - diffuse) * share
    return hazed


def _looks(pixels: Pixels) -> Look:
    surface = pixels.surface
    look = Look(
        albedo=surface[:3].copy(),
        gloss=surface[3].copy(),
        glow=surface[4].copy(),
        open_sky=np.ones(surface.shape[1], dtype=np.float32),
        normal=pixels.normal,
    )
    kind = surface[5]
    _look_at_walls(pixels, look, np.flatnonzero(kind == SurfaceKind.FACADE))
    _look_at_masonry(pixels, look, np.flatnonzero(kind == SurfaceKind.MASONRY))
    flat = np.flatnonzero(kind == SurfaceKind.PAVING)
    look.albedo[:, flat] = paving(
        pixels.position[0, flat],
        pixels.position[1, flat],
        look.albedo[:, flat],
        ground_footprint(pixels.direction[:, flat], pixels.metres_per_pixel[flat]),
    )
    lawn = np.flatnonzero(kind == SurfaceKind.GRASS)
    footprint = ground_footprint(
        pixels.direction[:, lawn], pixels.metres_per_pixel[lawn]
    )
    look.albedo[:, lawn] = grass(
        pixels.position[0, lawn], pixels.position[1, lawn], footprint[0]
    )
    return look


def _look_at_walls(pixels: Pixels, look: Look, chosen: NDArray[np.int64]) -> None:
    size = pixels.metres_per_pixel[chosen]
    normal = np.take(pixels.normal, chosen, axis=1)
    direction = np.take(pixels.direction, chosen, axis=1)
    facing = np.abs(dot(normal, direction))
    upright = np.sqrt(np.maximum(1 - direction[2] ** 2, 0.05))
    surface = np.take(pixels.surface, chosen, axis=1)
    walls = Walls(
        np.take(pixels.position, chosen, axis=1),
        normal,
        surface[:3],
        surface[6:10],
        (size / upright, size / np.maximum(facing, 0.04)),
    )
    albedo, gloss, glow, open_sky, tilt = walls.look()
    look.albedo[:, chosen], look.gloss[chosen] = albedo, gloss
    look.glow[chosen], look.open_sky[chosen] = glow, open_sky
    look.normal[:, chosen] = normal + np.stack([tilt, -tilt, 0.4 * tilt])


def _look_at_masonry(pixels: Pixels, look: Look, chosen: NDArray[np.int64]) -> None:
    x, y, z = np.take(pixels.position, chosen, axis=1)
    along = x + y
    tone = 1 + 0.09 * sample(cloudy_tile(41), along, z, 18.0)
    tone += 0.07 * sample(cloudy_tile(42), along * 0.5, z * 3, 30.0)
    near = 1 / (1 + (pixels.metres_per_pixel[chosen] * 40) ** 2)
    joint = wrapped(z, 0.3) < 0.02
    joint |= wrapped(along + 0.3 * (np.floor(z / 0.3) % 2), 0.6) < 0.02
    look.albedo[:, chosen] *= tone - 0.22 * joint * near


def _irradiance(
    pixels: Pixels, look: Look, leaf: NDArray[np.bool_], light: Lighting
) -> Float32:
    daylight = light.daylight
    facing = dot(look.normal, daylight.sun)
    lit = np.maximum(facing, 0.0)
    # Light also shines through leaves and wraps around their clumps.
    wrap = np.clip(0.5 + 0.5 * facing[leaf], 0, 1)
    lit[leaf] = 0.20 + 0.58 * wrap * np.sqrt(wrap)
    in_sun = np.flatnonzero(lit > 0)
    shine = np.ones(len(in_sun), dtype=np.float32)
    # Start from the front side of the surface, or its own texels would shade it.
    points = pixels.position + look.normal * np.float32(0.05)
    points = np.take(points, in_sun, axis=1)
    for shadow in light.shadows:
        shine = np.minimum(shine, shadow.shine(points))
    direct = np.zeros_like(lit)
    direct[in_sun] = lit[in_sun] * shine
    upwards = 0.5 + 0.5 * look.normal[2]
    dome = column(daylight.zenith) * 0.55 + column(daylight.horizon) * 0.45
    ambient = mixed(column(daylight.bounce), dome, upwards)
    total: Float32 = column(daylight.sunlight) * direct
    total += ambient * look.open_sky
    return total


def _with_mirror(
    pixels: Pixels,
    look: Look,
    diffuse: Float32,
    shiny: NDArray[np.int64],
    daylight: Daylight,
) -> Float32:
    ray = np.take(pixels.direction, shiny, axis=1)
    normal = np.take(look.normal, shiny, axis=1)
    facing = dot(ray, normal)
    away = ray - 2 * facing * normal
    gloss = look.gloss[shiny]
    grazing = power(1 - np.clip(np.abs(facing), 0, 1), 5)
    share = gloss + (1 - gloss) * grazing * np.minimum(1, gloss * 12)
    mirrored = mirrored_surroundings(daylight, away)
    towards_sun = np.clip(dot(away, daylight.sun), 0, 1)
    sparkle = 9.0 * power(towards_sun, 220) + 0.35 * power(towards_sun, 24)
    sparkle *= gloss > 0.03
    mirrored = mirrored + column(daylight.sunlight) * sparkle
    mirrored *= look.open_sky[shiny]
    return mixed(np.take(diffuse, shiny, axis=1), mirrored, share)


def sky_light(daylight: Daylight, direction: Float32) -> Float32:
    """(3, N): light from each direction (3, N) of the sky, without clouds."""
    share = np.sqrt(np.clip(direction[2], 0.0, 1.0))
    light = mixed(column(daylight.horizon), column(daylight.zenith), share)
    towards = np.clip(dot(direction, daylight.sun), 0.0, 1.0)
    halo = 0.28 * power(towards, 6) + 0.55 * power(towards, 48)
    return np.asarray(light + column(daylight.sunlight) * (0.22 * halo))


def mirrored_surroundings(daylight: Daylight, direction: Float32) -> Float32:
    """(3, N): what a mirror in a street shows: sky above, dull houses, road below."""
    light = sky_light(daylight, direction)
    road = column(daylight.bounce)
    house = road * 1.1 + column(daylight.horizon) * 0.10
    # Roof lines are not level: a wobble around the horizon makes the mirror believable.
    bearing = np.arctan2(direction[1], direction[0])
    roofs = 0.22 + 0.10 * np.sin(7.0 * bearing) * np.sin(17.0 * bearing + 1.0)
    above = np.clip((direction[2] - roofs) / 0.06 + 0.5, 0.0, 1.0)
    below = np.clip(-direction[2] / 0.1, 0.0, 1.0)
    return mixed(mixed(house, road * 0.55, below), light, above)


def sky_with_clouds(daylight: Daylight, direction: Float32) -> Float32:
    """(3, N): the sky as the camera sees it."""
    light = sky_light(daylight, direction)
    if daylight.clouds <= 0:
        return light
    height = np.maximum(direction[2], 0.02)
    scale = 130.0 / (height + 0.12)
    u, v = direction[0] * scale, direction[1] * scale
    density = _bilinear(cloudy_tile(11), u, v)
    towards_sun = f32(daylight.sun[:2]) * 9.0
    lit_side = _bilinear(cloudy_tile(11), u + towards_sun[0], v + towards_sun[1])
    cover = np.clip((density + 2.4 * daylight.clouds - 1.35) * 0.75, 0.0, 1.0)
    cover *= np.clip(height * 7.0, 0.0, 1.0) * 0.92
    shine = np.clip(0.86 + 0.22 * (density - lit_side), 0.5, 1.25)
    white = column(daylight.horizon) * 0.62 + column(daylight.sunlight) * 0.20
    return mixed(light, white * shine, cover)


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


@dataclass(frozen=True, eq=False)
class ShadowMap:
    """Heights towards the sun over a grid across its rays."""

    axes: FloatArray
    """(3, 3): across, up, towards the sun."""
    origin: FloatArray
    """(2,) metres: the grid's corner."""
    texel: FloatArray
    """(2,) metres."""
    highest: Float32

    @classmethod
    def of(
        cls,
        meshes: Iterable[Mesh],
        sun: tuple[float, float, float],
        area: FloatArray,
        texels: tuple[int, int],
    ) -> ShadowMap:
        """Map triangles as the sun sees them.

        `meshes` are taken a few at a time to save memory; `area` are points that the
        map has to cover; `texels` its width and height.
        """
        axes = sun_axes(sun)
        flat = area @ axes[:2].T
        origin, end = flat.min(axis=0), flat.max(axis=0)
        texel = (end - origin) / np.array(texels)
        canvas = Canvas.blank(*texels, nearness=_LOWEST)
        remaining = iter(meshes)
        while batch := list(itertools.islice(remaining, _MESHES_AT_ONCE)):
            mesh = join(batch)
            # What is turned away from the sun lies behind the sunlit side of its body.
            sunlit = along(mesh.normals[:, 0] + mesh.normals[:, 1], sun) > 0
            sunlit |= mesh.surface[:, 5] == SurfaceKind.LEAF
            screen = turned(mesh.corners[sunlit], axes)
            screen[..., :2] = (screen[..., :2] - origin) / texel
            draw(canvas, screen, np.arange(len(screen)))
        return cls(axes, origin, texel, canvas.nearness)

    def shine(self, points: Float32) -> Float32:
        """(N,) 0..1: how much of the sun reaches each of (3, N) points."""
        axes = self.axes
        origin, texel = f32(self.origin), f32(self.texel)
        u = (dot(points, axes[0]) - origin[0]) / texel[0]
        v = (dot(points, axes[1]) - origin[1]) / texel[1]
        height = dot(points, axes[2]) + np.float32(_BIAS)
        rows, columns = self.highest.shape
        inside = np.flatnonzero((u > 1) & (u < columns - 1) & (v > 1) & (v < rows - 1))
        u, v, height = u[inside], v[inside], height[inside]
        flat, total = self.highest.reshape(-1), np.zeros(len(inside), dtype=np.float32)
        for du, dv in _TAPS:
            row = (v + np.float32(dv)).astype(np.int32)
            total += (
                flat[row * columns + (u + np.float32(du)).astype(np.int32)] <= height
            )
        shine = np.ones(points.shape[1], dtype=np.float32)
        shine[inside] = total / np.float32(len(_TAPS))
        return shine


def sun_axes(sun: tuple[float, float, float]) -> FloatArray:
    """(3, 3): two directions across the rays, the first one level, and the sun's."""
    towards = np.array(sun) / np.linalg.norm(sun)
    level = np.cross([0.0, 0.0, 1.0], towards)
    level /= np.linalg.norm(level)
    return np.stack([level, np.cross(towards, level), towards])


def ambient_occlusion(depth: Float32, focal: float) -> Float32:
    """(H, W) 0..1: how much of the sky a pixel's surroundings leave open.

    Pairs of opposite neighbours: on a plane their mean nearness is the pixel's own;
    in a corner they are nearer.
    """
    height, width = depth.shape
    half_wh = (width // 2, height // 2)
    small = f32(cv2.resize(1.0 / depth, half_wh, interpolation=cv2.INTER_NEAREST))
    closed = np.zeros_like(small)
    for reach in (3, 7, 15):
        for du, dv in ((1, 0), (0, 1), (0.7, 0.7), (0.7, -0.7)):
            x, y = round(du * reach), round(dv * reach)
            closed += _pair_occlusion(small, x, y, focal / 2)
    open_sky = 1 - np.clip(closed / 12 * 2.6, 0, 0.72)
    blurred = cv2.blur(open_sky, (5, 5))
    return np.asarray(
        cv2.resize(blurred, (width, height), interpolation=cv2.INTER_LINEAR)
    )


def _pair_occlusion(nearness: Float32, x: int, y: int, focal: float) -> Float32:
    shifted = []
    padded = cv2.copyMakeBorder(nearness, 16, 16, 16, 16, cv2.BORDER_REPLICATE)
    rows, columns = nearness.shape
    for sign in (1, -1):
        top, left = 16 + sign * y, 16 + sign * x
        shifted.append(padded[top : top + rows, left : left + columns])
    mean = (shifted[0] + shifted[1]) * np.float32(0.5)
    step_m = np.float32(np.hypot(x, y) / focal) / nearness
    rise_m = (mean - nearness) / (nearness * nearness)
    closed = np.clip(rise_m / np.maximum(step_m, 0.02), 0, 1)
    # Far in front is another object, and wide steps say nothing about a near corner.
    closed *= np.clip(1.6 - rise_m / 1.2, 0, 1) * np.clip(2.0 - step_m / 0.7, 0, 1)
    return np.asarray(closed)


def develop(light: Float32, exposure: float) -> Float32:
    """Levels of a display from linear light, by a curve like film's."""
    root = np.sqrt(light * np.float32(exposure))
    return np.asarray(_LEVELS[np.minimum(root * _STEPS, _LAST).astype(np.int32)])


_STEPS: Final = np.float32(2048)
_LAST: Final = np.float32(8191)


def _levels() -> Float32:
    x = np.square(np.arange(_LAST + 1) / _STEPS)
    # Narkowicz, "ACES filmic tone mapping curve", 2015.
    film = np.clip((x * (2.51 * x + 0.03)) / (x * (2.43 * x + 0.59) + 0.14), 0, 1)
    bent = 1.055 * film ** (1 / 2.4) - 0.055
    return f32(np.where(film <= 0.0031308, 12.92 * film, bent) * 255)


_LEVELS: Final = _levels()
"""Levels of a display by the sRGB curve, for the roots of light up to 16."""
