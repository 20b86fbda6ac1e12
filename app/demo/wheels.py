"""Wheels of cars, vans, buses and trucks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.demo.mesh import Mesh, join
from app.demo.paint import BLACK, CHROME, RUBBER, STEEL
from app.demo.solids import sheet, tube


@dataclass(frozen=True)
class Wheels:
    """Four wheels; metres.

    Attributes
    ----------
    front, rear : x of the axles
    half_width : y of the wheels' outer sides
    radius : of the tyres
    tag : of the vehicle
    """

    front: float
    rear: float
    half_width: float
    radius: float
    tag: int

    def mesh(self, *, fine: bool = True) -> Mesh:
        """The wheels in their dark arches; from afar, without hubs and spokes."""
        build = _wheel if fine else _far_wheel
        right = [build(self, x) for x in (self.front, self.rear)]
        return join(right).both_sides()


def _far_wheel(wheels: Wheels, x: float) -> Mesh:
    y, z, tag = wheels.half_width, wheels.radius, wheels.tag
    inner = (x, y - 0.2, z)
    tyre = tube(inner, (x, y + 0.012, z), wheels.radius, (RUBBER, tag), sides=10)
    rim = tube(inner, (x, y + 0.016, z), wheels.radius * 0.66, (STEEL, tag), sides=6)
    return join([tyre, rim])


def _wheel(wheels: Wheels, x: float) -> Mesh:
    y, radius, tag = wheels.half_width, wheels.radius, wheels.tag
    z = radius
    arch = tube(
        (x, y - 0.25, z), (x, y + 0.004, z), radius * 1.15, (BLACK, tag), sides=20
    )
    tyre = tube((x, y - 0.22, z), (x, y + 0.012, z), radius, (RUBBER, tag), sides=20)
    rim = tube((x, y, z), (x, y + 0.016, z), radius * 0.68, (STEEL, tag), sides=14)
    hub = tube((x, y, z), (x, y + 0.024, z), radius * 0.16, (CHROME, tag), sides=8)
    gaps = [_spoke_gap((x, y + 0.020, z), radius, turn, tag) for turn in range(5)]
    return join([arch, tyre, rim, hub, *gaps])


def _spoke_gap(
    centre: tuple[float, float, float], radius: float, turn: int, tag: int
) -> Mesh:
    middle = 2 * np.pi * turn / 5 + 0.3
    angles = middle + np.array([-0.38, -0.24, 0.24, 0.38])
    reach = radius * np.array([0.60, 0.22, 0.22, 0.60])
    corners = np.stack(
        [np.cos(angles) * reach, np.zeros(4), np.sin(angles) * reach], axis=1
    )
    return sheet(corners + np.array(centre), (0, 1, 0), BLACK, tag)
