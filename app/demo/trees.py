"""Trees, bushes and hedges: irregular, leafy, and full of small holes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.demo.mesh import Mesh, join
from app.demo.paint import Kind, Paint, Tag
from app.demo.solids import block, tube
from filter_core.types import FloatArray

RGB = tuple[float, float, float]


@dataclass(frozen=True)
class TreeKind:
    """A species.

    Attributes
    ----------
    height, crown : height of the tree, half sizes (x, y, z) of its crown, metres
    leaf : length of a leaf spray, metres
    green : its colour
    bark : its trunk's colour
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
    core = Paint((38, 52, 24), kind=Kind.LEAF)
    low, high = (-length / 2, -depth / 2), (length / 2, depth / 2)
    inner = block((*low, 0.0), (*high, height - 0.06), core, Tag.VEGETATION)
    count = int(46 * (length * depth + 2 * (length + depth) * height))
    places = _on_box(length, depth, height, count, rng)
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
    mesh = Mesh.of(corners, both, Paint(green, kind=Kind.LEAF), Tag.VEGETATION)
    tint = np.clip(np.concatenate([shade, shade]), 0.15, 1.6).astype(np.float32)
    mesh.surface[:, :3] *= tint[:, None]
    # Sunny leaves are yellower.
    mesh.surface[:, 0] *= 0.88 + 0.12 * tint
    return mesh


def _on_box(
    length: float, depth: float, height: float, count: int, rng: np.random.Generator
) -> FloatArray:
    """Random places on the surface of a box around the origin, not on its floor."""
    half = np.array([length, depth, height]) / 2
    places = rng.uniform(-1, 1, (count, 3))
    areas = np.array([depth * height, length * height, length * depth / 2])
    side = rng.choice(3, size=count, p=areas / areas.sum())
    sign = np.where(side == 2, 1.0, rng.choice([-1.0, 1.0], size=count))
    places[np.arange(count), side] = sign * (1 + rng.normal(0, 0.012, count))
    return np.asarray(places * half)
