"""Objects along a street: traffic lights, lamps, signs, walls, benches and trees.

Trees, bushes and hedges are irregular, leafy, and full of small holes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np

from filter_core.arrays import FloatArray
from unghost.street.mesh import (
    Block,
    Mesh,
    ball,
    block,
    blocks,
    join,
    loft,
    sheet,
    tube,
)
from unghost.street.paint import (
    BLACK,
    CONCRETE,
    DARK_STEEL,
    GLASS,
    RGB,
    STEEL,
    Paint,
    SurfaceKind,
    Tag,
)

RED, AMBER, GREEN = range(3)
_LIT: Final = (
    Paint((255, 46, 30), glow=2.6),
    Paint((255, 170, 30), glow=2.4),
    Paint((40, 255, 120), glow=2.2),
)
_DARK: Final = (Paint((58, 12, 10)), Paint((62, 44, 10)), Paint((10, 50, 28)))
_WOOD: Final = Paint((124, 88, 56))
_RED, _WHITE, _BLUE = Paint((190, 30, 32)), Paint((236, 236, 230)), Paint((34, 84, 160))
_Disc: TypeAlias = tuple[float, float, float, Paint]
_SIGNS: Final[tuple[tuple[list[_Disc], list[Block]], ...]] = (
    ([(0.01, 0.03, 0.34, _RED), (-0.004, 0.01, 0.25, _WHITE)], []),
    (
        [(0.01, 0.03, 0.36, _BLUE)],
        [((-0.006, -0.05, 2.12), (0.01, 0.05, 2.48), _WHITE)],
    ),
    (
        [],
        [
            ((0.0, -0.34, 1.96), (0.03, 0.34, 2.64), _BLUE),
            ((-0.008, -0.14, 2.08), (0.0, -0.05, 2.52), _WHITE),
            ((-0.008, -0.05, 2.28), (0.0, 0.15, 2.52), _WHITE),
        ],
    ),
)
"""Per kind of sign its discs (from x, to x, radius) and its blocks."""

_ARM_M: Final = 4.6
"""Length of the arm that holds a traffic light over the road."""


def traffic_light(state: int) -> Mesh:
    """A light for traffic that heads along x; its arm reaches over the road to -y.

    The upright is tagged Pole, all that hangs from it TrafficLight.
    """
    pole = (DARK_STEEL, Tag.POLE)
    held = (DARK_STEEL, Tag.TRAFFIC_LIGHT)
    parts = [
        tube((0, 0, 0), (0, 0, 6.1), (0.13, 0.09), pole, 10),
        tube((0, 0, 0), (0, 0, 0.5), 0.19, pole, 10),
        tube((0, 0, 5.75), (0, -_ARM_M, 6.05), (0.085, 0.055), held, 8),
        tube((0, -0.1, 5.1), (0, -1.4, 5.82), 0.035, held, 6),
    ]
    for y, z in ((-_ARM_M + 0.15, 5.55), (-_ARM_M * 0.52, 5.42), (-0.32, 2.75)):
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
    discs, bars = _SIGNS[kind]
    tag = Tag.TRAFFIC_SIGN
    round_parts = [
        tube((near, 0, 2.3), (far, 0, 2.3), radius, (paint, tag), 18)
        for near, far, radius, paint in discs
    ]
    return join([post, *round_parts, blocks(bars, tag)])


def wall(length: float, height: float, rgb: RGB) -> Mesh:
    """A garden wall along x, with a coping."""
    face = Paint(rgb, kind=SurfaceKind.MASONRY)
    half, top = length / 2, height + 0.09
    pillars = np.linspace(-half, half, max(2, int(length / 4) + 1))
    dark = face.tinted(0.95)
    rows = [
        ((-half, -0.13, 0), (half, 0.13, height), face),
        ((-half - 0.03, -0.19, height), (half + 0.03, 0.19, top), CONCRETE),
        *(((x - 0.2, -0.2, 0), (x + 0.2, 0.2, height + 0.22), dark) for x in pillars),
    ]
    return blocks(rows, Tag.WALL)


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
    slats, back, legs = (-0.25, -0.13, -0.01), (0.58, 0.74), (-0.7, 0.7)
    rows = [
        *(((-0.85, y, 0.44), (0.85, y + 0.09, 0.48), _WOOD) for y in slats),
        *(((-0.85, 0.14, z), (0.85, 0.18, z + 0.1), _WOOD) for z in back),
        *(((x - 0.03, -0.25, 0), (x + 0.03, 0.18, 0.44), DARK_STEEL) for x in legs),
    ]
    return blocks(rows, Tag.STATIC)


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
    posts = (-1.9, -0.6, 0.6, 1.9)
    rows = [
        *(((x - 0.04, 0.55, 0), (x + 0.04, 0.63, 2.4), DARK_STEEL) for x in posts),
        ((-2.05, -0.75, 2.4), (2.05, 0.72, 2.5), DARK_STEEL),
        ((-1.85, 0.58, 0.35), (0.55, 0.60, 2.2), Paint((96, 116, 120), gloss=0.15)),
        ((0.65, 0.57, 0.35), (1.85, 0.61, 2.2), Paint((214, 170, 92))),
        ((0.75, 0.56, 0.9), (1.75, 0.57, 1.9), Paint((52, 110, 140))),
        ((-1.6, 0.15, 0.42), (0.4, 0.5, 0.48), _WOOD),
        ((1.86, -0.6, 0.3), (1.92, 0.55, 2.2), GLASS),
    ]
    return blocks(rows, Tag.STATIC)


def planter(rng: np.random.Generator) -> Mesh:
    """An empty stone tub; the caller adds the plants."""
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


@dataclass(frozen=True)
class TreeKind:
    """A species: its height and the half sizes (x, y, z) of its crown, in metres.

    `leaf` is the length of a leaf spray, `green` its colour, `bark` the trunk's.
    """

    height: float
    crown: tuple[float, float, float]
    leaf: float
    green: RGB
    bark: RGB


PLANE_TREE = TreeKind(8.6, (2.7, 2.7, 2.9), 0.23, (98, 112, 56), (120, 106, 84))
LINDEN = TreeKind(7.4, (2.1, 2.1, 2.6), 0.20, (80, 104, 54), (86, 72, 58))
MAPLE = TreeKind(7.0, (2.4, 2.4, 2.3), 0.21, (150, 112, 48), (82, 70, 58))
POPLAR = TreeKind(11.5, (1.3, 1.3, 4.6), 0.21, (72, 96, 52), (104, 96, 80))


def tree(kind: TreeKind, rng: np.random.Generator, detail: float = 1.0) -> Mesh:
    """A tree at the origin; `detail` below 1 has fewer, larger leaves."""
    centre = np.array([0.0, 0.0, kind.height - kind.crown[2]])
    bark = (Paint(kind.bark), Tag.VEGETATION)
    fork = centre - np.array([0.0, 0.0, kind.crown[2] * 0.45])
    trunk = tube((0, 0, -0.1), fork, (0.19, 0.13), bark, 9)
    clumps = _clumps(kind, rng) + centre
    boughs = [
        tube(fork, fork + 0.8 * (clump - fork), (0.075, 0.03), bark, 5)
        for clump in clumps[:7]
    ]
    leaves = _leaves(clumps, centre, kind, rng, detail)
    return join([trunk, *boughs, leaves])


def hedge(length: float, depth: float, height: float, rng: np.random.Generator) -> Mesh:
    """A clipped hedge along x, dense enough to hide what is behind it."""
    core = Paint((38, 52, 24), kind=SurfaceKind.LEAF)
    low, high = (-length / 2, -depth / 2), (length / 2, depth / 2)
    inner = block((*low, 0.0), (*high, height - 0.06), core, Tag.VEGETATION)
    count = int(46 * (length * depth + 2 * (length + depth) * height))
    # On the surface of a box around the origin, not on its floor
    half = np.array([length, depth, height]) / 2
    places = rng.uniform(-1, 1, (count, 3))
    areas = np.array([depth * height, length * height, length * depth / 2])
    side = rng.choice(3, size=count, p=areas / areas.sum())
    sign = np.where(side == 2, 1.0, rng.choice([-1.0, 1.0], size=count))
    places[np.arange(count), side] = sign * (1 + rng.normal(0, 0.012, count))
    places = np.asarray(places * half)
    outwards = places / np.array([length / 2, depth / 2, height / 2])
    outwards = outwards * (np.abs(outwards) > 0.96) + rng.normal(0, 0.35, places.shape)
    shade = 0.72 + 0.36 * (places[:, 2] / height + 0.5) + rng.normal(0, 0.10, count)
    leaves = _sprays(places, outwards, 0.15, rng)
    tinted = _leaf_mesh(leaves, outwards, (76, 104, 44), shade)
    return join([inner, tinted.moved(z=height / 2)])


def bush(radius: float, rng: np.random.Generator) -> Mesh:
    """A round shrub on the ground."""
    kind = TreeKind(
        radius * 1.5, (radius, radius, radius * 0.75), 0.16, (92, 116, 52), (70, 60, 50)
    )
    centre = np.array([0.0, 0.0, radius * 0.65])
    clumps = _clumps(kind, rng)[:14] * 0.8 + centre
    return _leaves(clumps, centre, kind, rng, 0.6)


def _clumps(kind: TreeKind, rng: np.random.Generator) -> FloatArray:
    count = 34
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    reach = rng.uniform(0.35, 0.86, (count, 1))
    wobble = rng.normal(0, 0.07, (count, 3))
    return np.asarray((directions * reach + wobble) * np.array(kind.crown))


def _leaves(
    clumps: FloatArray,
    centre: FloatArray,
    kind: TreeKind,
    rng: np.random.Generator,
    detail: float,
) -> Mesh:
    per_clump = int(170 * detail)
    size = kind.leaf / np.sqrt(detail)
    clump = np.repeat(clumps, per_clump, axis=0)
    count = len(clump)
    spread = min(kind.crown) * 0.36
    offset = rng.normal(size=(count, 3))
    offset *= rng.uniform(0.25, 1.0, (count, 1)) ** 0.5 / np.linalg.norm(
        offset, axis=1, keepdims=True
    )
    places = clump + offset * spread * np.array([1.1, 1.1, 0.8])
    from_centre = (places - centre) / np.array(kind.crown)
    out = np.linalg.norm(from_centre, axis=1)
    normals = 0.9 * from_centre + 0.55 * offset + np.array([0, 0, 0.15])
    normals += rng.normal(0, 0.22, normals.shape)
    # Leaves deep inside and low down see little sky.
    shade = np.clip(0.40 + 0.52 * out, 0.35, 1.0) * (0.90 + 0.16 * from_centre[:, 2])
    shade *= 1 + 0.13 * rng.normal(size=count)
    return _leaf_mesh(_sprays(places, normals, size, rng), normals, kind.green, shade)


def _sprays(
    places: FloatArray, normals: FloatArray, size: float, rng: np.random.Generator
) -> FloatArray:
    """(N, 4, 3) small rhombs that lie roughly across their normals."""
    count = len(places)
    along = rng.normal(size=(count, 3)) + np.array([0, 0, -0.35])
    along -= (
        0.6
        * normals
        * np.sum(along * normals, axis=1, keepdims=True)
        / (np.sum(normals**2, axis=1, keepdims=True) + 1e-9)
    )
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, rng.normal(size=(count, 3)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    length = size * rng.uniform(0.6, 1.25, (count, 1))
    along, across = (
        along * length / 2,
        across * length * rng.uniform(0.22, 0.42, (count, 1)),
    )
    return np.stack(
        [places - along, places + across, places + along, places - across], axis=1
    )


def _leaf_mesh(
    quads: FloatArray, normals: FloatArray, green: RGB, shade: FloatArray
) -> Mesh:
    corners = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    unit = normals / (np.linalg.norm(normals, axis=1, keepdims=True) + 1e-9)
    both = np.repeat(np.concatenate([unit, unit])[:, None], 3, axis=1)
    mesh = Mesh.of(corners, both, Paint(green, kind=SurfaceKind.LEAF), Tag.VEGETATION)
    tint = np.clip(np.concatenate([shade, shade]), 0.15, 1.6).astype(np.float32)
    mesh.surface[:, :3] *= tint[:, None]
    # Sunny leaves are yellower.
    mesh.surface[:, 0] *= 0.88 + 0.12 * tint
    return mesh
