"""Where the sun shines: maps of what is nearest to it."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from app.demo.mesh import along, turned
from app.demo.rasteriser import Canvas, draw
from app.demo.textures import Float32
from filter_core.types import FloatArray

_LOWEST: Final = -1e6
_MESHES_AT_ONCE: Final = 32
_BIAS: Final = 0.06
"""Metres that a surface may lie under the map without being in its own shadow."""
_TAPS: Final = ((-0.7, -0.3), (0.3, -0.7), (0.7, 0.3), (-0.3, 0.7))


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
        meshes: Iterable[FloatArray],
        sun: tuple[float, float, float],
        area: FloatArray,
        texels: tuple[int, int],
    ) -> ShadowMap:
        """Map triangles as the sun sees them.

        `meshes` are arrays (T, 3, 3) of corners, taken a few at a time to save memory;
        `area` are points that the map has to cover; `texels` its width and height.
        """
        axes = sun_axes(sun)
        flat = area @ axes[:2].T
        origin, end = flat.min(axis=0), flat.max(axis=0)
        texel = (end - origin) / np.array(texels)
        canvas = Canvas.blank(*texels, nearness=_LOWEST)
        remaining = iter(meshes)
        while batch := list(itertools.islice(remaining, _MESHES_AT_ONCE)):
            screen = turned(np.concatenate(batch), axes)
            screen[..., :2] = (screen[..., :2] - origin) / texel
            draw(canvas, screen, np.arange(len(screen)))
        return cls(axes, origin, texel, canvas.nearness)

    def shine(self, points: Float32) -> Float32:
        """(N,) 0..1: how much of the sun reaches each of (N, 3) points."""
        axes = self.axes
        u = (along(points, axes[0]) - np.float32(self.origin[0])) / np.float32(
            self.texel[0]
        )
        v = (along(points, axes[1]) - np.float32(self.origin[1])) / np.float32(
            self.texel[1]
        )
        height = along(points, axes[2]) + np.float32(_BIAS)
        rows, columns = self.highest.shape
        flat, total = self.highest.reshape(-1), np.zeros(len(points), dtype=np.float32)
        for du, dv in _TAPS:
            column = (u + np.float32(du)).astype(np.int32)
            row = (v + np.float32(dv)).astype(np.int32)
            inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
            place = np.where(inside, row * columns + column, 0)
            total += ~inside | (flat[place] <= height)
        return np.asarray(total / np.float32(len(_TAPS)))


def sun_axes(sun: tuple[float, float, float]) -> FloatArray:
    """(3, 3): two directions across the rays, the first one level, and the sun's."""
    towards = np.array(sun) / np.linalg.norm(sun)
    level = np.cross([0.0, 0.0, 1.0], towards)
    level /= np.linalg.norm(level)
    return np.stack([level, np.cross(towards, level), towards])
