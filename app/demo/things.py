"""The objects of a town: their shapes, their boxes, and where they are when."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from app.demo.mesh import Mesh
from app.demo.paint import FAMILY
from filter_core.classes import accept_mask_of
from filter_core.geometry.pose import Transform
from filter_core.types import FloatArray

SCENERY: Final = "scenery"
"""The class of what CARLA hands out no box for."""

HOUSE_TYPE: Final = "static.building"
_SWAY_S: Final = 23.0


@dataclass(frozen=True)
class Route:
    """Straight on at one speed, and from the start again.

    Attributes
    ----------
    speed : metres per second, along the heading
    length : metres until the start comes again; 0 stands still
    ahead : metres already gone at time 0
    sway : metres that it falls back and catches up, again and again
    """

    speed: float = 0.0
    length: float = 0.0
    ahead: float = 0.0
    sway: float = 0.0

    def gone(self, time_s: float) -> float:
        """Metres from the start of the route."""
        if not self.length:
            return 0.0
        swayed = self.sway * math.sin(2 * math.pi * time_s / _SWAY_S)
        return (self.ahead + self.speed * time_s) % self.length + swayed


@dataclass(frozen=True, eq=False)
class Thing:
    """One object.

    Attributes
    ----------
    instance : its number in instance images, 1..65535
    class_name : as annotations say it, or `SCENERY`
    type_id, base_type : as CARLA names it
    shapes : what it looks like, one after the other
    start : where it is, or where its route begins
    shape_s : seconds that one shape lasts
    far_shapes : coarser ones for afar, as many as shapes, or none
    """

    instance: int
    class_name: str
    type_id: str
    base_type: str
    shapes: tuple[Mesh, ...]
    start: Transform
    route: Route = Route()
    shape_s: float = 0.0
    shape_offset: int = 0
    far_shapes: tuple[Mesh, ...] = ()

    @property
    def moves(self) -> bool:
        """Whether it has to be placed anew for each frame."""
        return self.route.length > 0 or len(self.shapes) > 1

    @property
    def hides(self) -> bool:
        """Whether it is a house: large, and nothing can be seen through it."""
        return self.type_id == HOUSE_TYPE

    @property
    def has_box(self) -> bool:
        """Whether CARLA hands out a box for it."""
        return self.class_name != SCENERY

    @cached_property
    def accept_mask(self) -> int:
        """Bit t is set if its class accepts tag t; 0 for scenery."""
        return accept_mask_of(self.class_name, FAMILY) if self.has_box else 0

    @cached_property
    def box(self) -> tuple[FloatArray, FloatArray]:
        """Centre and half size of the box around all shapes, in its own axes."""
        bounds = [shape.bounds for shape in self.shapes]
        low = np.min([low for low, _ in bounds], axis=0)
        high = np.max([high for _, high in bounds], axis=0)
        return (low + high) / 2, (high - low) / 2

    @cached_property
    def reach(self) -> float:
        """Radius around the box's centre that holds the thing, metres."""
        return float(np.linalg.norm(self.box[1]))

    def pose(self, time_s: float) -> Transform:
        """Where it is at a time."""
        if not self.route.length:
            return self.start
        yaw = np.radians(self.start.rotation[1])
        gone = self.route.gone(time_s)
        x, y, z = self.start.location
        place = (x + gone * float(np.cos(yaw)), y + gone * float(np.sin(yaw)), z)
        return replace(self.start, location=place)

    def shape(self, time_s: float, *, far: bool = False) -> Mesh:
        """What it looks like at a time."""
        shapes = self.far_shapes if far and self.far_shapes else self.shapes
        if len(shapes) == 1:
            return shapes[0]
        step = int(time_s / self.shape_s) + self.shape_offset
        return shapes[step % len(shapes)]
