"""What stands along a street: traffic lights, lamps, signs, walls, fences, benches."""

from __future__ import annotations

from typing import Final

import numpy as np

from app.demo.mesh import Mesh, join
from app.demo.paint import (
    BLACK,
    CONCRETE,
    DARK_STEEL,
    GLASS,
    STEEL,
    Kind,
    Paint,
    Tag,
)
from app.demo.solids import ball, block, loft, sheet, tube

RED, AMBER, GREEN = range(3)
_LIT: Final = (
    Paint((255, 46, 30), glow=2.6),
    Paint((255, 170, 30), glow=2.4),
    Paint((40, 255, 120), glow=2.2),
)
_DARK: Final = (Paint((58, 12, 10)), Paint((62, 44, 10)), Paint((10, 50, 28)))
_WOOD: Final = Paint((124, 88, 56))


def traffic_light(state: int, arm: float = 4.6) -> Mesh:
    """A light for traffic that heads along x; its arm reaches over the road to -y.

    The upright is tagged Pole, all that hangs from it TrafficLight.
    """
    pole = (DARK_STEEL, Tag.POLE)
    held = (DARK_STEEL, Tag.TRAFFIC_LIGHT)
    parts = [
        tube((0, 0, 0), (0, 0, 6.1), (0.13, 0.09), pole, 10),
        tube((0, 0, 0), (0, 0, 0.5), 0.19, pole, 10),
        tube((0, 0, 5.75), (0, -arm, 6.05), (0.085, 0.055), held, 8),
        tube((0, -0.1, 5.1), (0, -1.4, 5.82), 0.035, held, 6),
    ]
    for y, z in ((-arm + 0.15, 5.55), (-arm * 0.52, 5.42), (-0.32, 2.75)):
        parts.append(_head(state).moved(y=y, z=z))
    return join(parts)


def _head(state: int) -> Mesh:
    """Three lamps in a housing, looking against the traffic."""
    tag = Tag.TRAFFIC_LIGHT
    shell = Paint((34, 38, 36), gloss=0.03)
    parts = [
        block((-0.16, -0.19, -0.55), (0.12, 0.19, 0.55), shell, tag),
        block((0.10, -0.26, -0.63), (0.125, 0.26, 0.63), BLACK, tag),
    ]
    for lamp in (RED, AMBER, GREEN):
        z = 0.35 - 0.35 * lamp
        paint = _LIT[lamp] if lamp == state else _DARK[lamp]
        parts.append(tube((-0.185, 0, z), (-0.15, 0, z), 0.13, (paint, tag), 12))
        hood = [
            (-0.42, 0.13, z + 0.10), (-0.42, -0.13, z + 0.10),
            (-0.16, -0.15, z + 0.15), (-0.16, 0.15, z + 0.15),
        ]  # fmt: skip
        parts.append(sheet(hood, (0, 0, 1), shell, tag))
        parts.append(sheet(hood, (0, 0, -1), BLACK, tag))
    return join(parts)


def street_lamp() -> Mesh:
    """A tall lamp whose arm reaches to -y."""
    look = (STEEL, Tag.POLE)
    lamp = Paint((220, 216, 196), gloss=0.1, glow=0.1)
    return join(
        [
            tube((0, 0, 0), (0, 0, 7.6), (0.10, 0.06), look, 9),
            tube((0, 0, 0), (0, 0, 0.9), 0.13, look, 9),
            tube((0, 0, 7.55), (0, -1.9, 8.0), (0.055, 0.04), look, 7),
            block((-0.16, -2.5, 7.96), (0.16, -1.8, 8.08), STEEL, Tag.POLE),
            block((-0.13, -2.45, 7.93), (0.13, -1.85, 7.96), lamp, Tag.POLE),
        ]
    )


def sign(kind: int) -> Mesh:
    """A round, three-cornered or square traffic sign on a post, seen from -x."""
    post = tube((0.05, 0, 0), (0.05, 0, 2.6), 0.035, (STEEL, Tag.POLE), 6)
    tag = Tag.TRAFFIC_SIGN
    red, white, blue = (
        Paint((190, 30, 32)),
        Paint((236, 236, 230)),
        Paint((34, 84, 160)),
    )
    if kind == 0:
        board = [
            tube((0.01, 0, 2.3), (0.03, 0, 2.3), 0.34, (red, tag), 18),
            tube((-0.004, 0, 2.3), (0.01, 0, 2.3), 0.25, (white, tag), 18),
        ]
    elif kind == 1:
        board = [
            tube((0.01, 0, 2.3), (0.03, 0, 2.3), 0.36, (blue, tag), 18),
            block((-0.006, -0.05, 2.12), (0.01, 0.05, 2.48), white, tag),
        ]
    else:
        board = [
            block((0.0, -0.34, 1.96), (0.03, 0.34, 2.64), blue, tag),
            block((-0.008, -0.14, 2.08), (0.0, -0.05, 2.52), white, tag),
            block((-0.008, -0.05, 2.28), (0.0, 0.15, 2.52), white, tag),
        ]
    return join([post, *board])


def wall(length: float, height: float, rgb: tuple[float, float, float]) -> Mesh:
    """A garden wall along x, with a coping."""
    face = Paint(rgb, kind=Kind.MASONRY)
    half = length / 2
    parts = [
        block((-half, -0.13, 0), (half, 0.13, height), face, Tag.WALL),
        block(
            (-half - 0.03, -0.19, height),
            (half + 0.03, 0.19, height + 0.09),
            CONCRETE,
            Tag.WALL,
        ),
    ]
    for x in np.linspace(-half, half, max(2, int(length / 4) + 1)):
        parts.append(
            block(
                (x - 0.2, -0.2, 0),
                (x + 0.2, 0.2, height + 0.22),
                face.tinted(0.95),
                Tag.WALL,
            )
        )
    return join(parts)


def fence(length: float, height: float = 1.5) -> Mesh:
    """Iron railings along x."""
    look = (Paint((40, 48, 46), gloss=0.05), Tag.FENCE)
    half = length / 2
    along = np.arange(-half, half, 0.16)
    places = np.column_stack([along, np.zeros((len(along), 2))])
    bars = tube((0, 0, 0), (0, 0, height), 0.016, look, 3).repeated(places)
    rails = [
        tube((-half, 0, z), (half, 0, z), 0.026, look, 4) for z in (0.18, height - 0.14)
    ]
    posts = [
        block((x - 0.04, -0.04, 0), (x + 0.04, 0.04, height + 0.1), *look)
        for x in np.arange(-half, half + 0.1, 2.4)
    ]
    return join([bars, *rails, *posts])


def bench() -> Mesh:
    """A park bench along x, looking to -y."""
    tag = Tag.STATIC
    slats = [
        block((-0.85, y, 0.44), (0.85, y + 0.09, 0.48), _WOOD, tag)
        for y in (-0.25, -0.13, -0.01)
    ]
    back = [
        block((-0.85, 0.14, z), (0.85, 0.18, z + 0.1), _WOOD, tag) for z in (0.58, 0.74)
    ]
    legs = [
        block((x - 0.03, -0.25, 0), (x + 0.03, 0.18, 0.44), DARK_STEEL, tag)
        for x in (-0.7, 0.7)
    ]
    return join([*slats, *back, *legs])


def litter_bin() -> Mesh:
    """A round bin."""
    green = Paint((44, 76, 58), gloss=0.03)
    return join(
        [
            tube((0, 0, 0.1), (0, 0, 0.85), (0.22, 0.26), (green, Tag.STATIC), 12),
            tube((0, 0, 0.85), (0, 0, 0.92), 0.28, (DARK_STEEL, Tag.STATIC), 12),
        ]
    )


def bus_stop() -> Mesh:
    """A shelter along x, open to -y."""
    tag = Tag.STATIC
    frame, poster = DARK_STEEL, Paint((214, 170, 92))
    posts = [
        block((x - 0.04, 0.55, 0), (x + 0.04, 0.63, 2.4), frame, tag)
        for x in (-1.9, -0.6, 0.6, 1.9)
    ]
    return join(
        [
            *posts,
            block((-2.05, -0.75, 2.4), (2.05, 0.72, 2.5), frame, tag),
            block(
                (-1.85, 0.58, 0.35),
                (0.55, 0.60, 2.2),
                Paint((96, 116, 120), gloss=0.15),
                tag,
            ),
            block((0.65, 0.57, 0.35), (1.85, 0.61, 2.2), poster, tag),
            block((0.75, 0.56, 0.9), (1.75, 0.57, 1.9), Paint((52, 110, 140)), tag),
            block((-1.6, 0.15, 0.42), (0.4, 0.5, 0.48), _WOOD, tag),
            block((1.86, -0.6, 0.3), (1.92, 0.55, 2.2), GLASS, tag),
        ]
    )


def planter(rng: np.random.Generator) -> Mesh:
    """A stone tub; its plants are added by whoever places it."""
    wide = float(rng.uniform(0.5, 0.7))
    ring = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * wide
    rings = np.stack(
        [
            np.column_stack([ring * 0.82, np.zeros(4)]),
            np.column_stack([ring, np.full(4, 0.55)]),
        ]
    )
    soil = ball(
        (0, 0, 0.5),
        (wide * 0.9, wide * 0.9, 0.12),
        (Paint((60, 46, 34)), Tag.STATIC),
        8,
    )
    return join([loft(rings, [[CONCRETE]], Tag.STATIC), soil])
