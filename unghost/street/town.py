"""A town: its objects (things), at rest or moving, and the drive through it.

A `Thing` has shapes, a box, and a place at each time. A `TownBuilder` puts things into
a `Town`; `towns` and `traffic` decide which ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, TypeVar

import numpy as np

from filter_core.arrays import FloatArray
from filter_core.classes import accept_mask_of
from filter_core.geometry.pose import Transform
from unghost.street.furniture import TreeKind, tree
from unghost.street.ground import SIDEWALK_HEIGHT, RoadPlan
from unghost.street.light import Daylight
from unghost.street.mesh import Mesh
from unghost.street.paint import FAMILY

T = TypeVar("T")
STEP_S: Final = 1.25
"""Seconds between two frames of a town."""
DRIVE_SPEED: Final = 6.25
"""Metres per second."""
DRIVE_START: Final = -38.0
"""The x where the camera's drive begins, metres."""
DRIVE_LENGTH: Final = 250.0
"""Metres until the camera begins anew."""
TOWN_START, TOWN_END = -85.0, 345.0
"""The x where the main street begins and ends, metres."""
BACK_ROW: Final = 36.0
"""From the front of the first row of houses to the front of the second, metres."""
SIDE_END: Final = 92.0
"""Where the side streets end, metres from the main street's middle."""
SCENERY: Final = "scenery"
"""The class of objects for which CARLA has no box."""
HOUSE_TYPE: Final = "static.building"
_SWAY_S: Final = 23.0
"""Seconds in which something falls back and catches up once."""


@dataclass(frozen=True)
class TownStyle:
    """The parameters in which towns differ.

    Attributes
    ----------
    name : of the map
    seed : of everything random in it
    plan, daylight : its streets and its light
    weather : CARLA's parameters for the hour
    houses : styles of its houses, as often as each occurs
    storeys : lowest and highest
    trees : its species
    camera_height : metres
    gap_chance : of an open lot after a house
    parked : share of the kerb with a parked car
    """

    name: str
    seed: int
    plan: RoadPlan
    daylight: Daylight
    weather: dict[str, float]
    houses: tuple[int, ...]
    storeys: tuple[int, int]
    trees: tuple[TreeKind, ...]
    camera_height: float
    gap_chance: float
    parked: float


@dataclass(eq=False)
class Town:
    """A town that was built in a style."""

    style: TownStyle
    things: list[Thing] = field(default_factory=list)

    def camera(self, step: int) -> Transform:
        """Where the camera of a step is: in the right lane, looking a little around."""
        gone = (DRIVE_SPEED * STEP_S * step) % DRIVE_LENGTH
        lane = self.style.plan.lane_middle(0)
        aside = 14.0 * math.sin(2.1 * step) if step % 5 == 3 else 0.0
        yaw = 2.5 * math.sin(0.9 * step) + aside
        pitch = -1.5 + 1.2 * math.sin(1.7 * step)
        roll = 0.4 * math.sin(2.3 * step)
        return Transform(
            (round(DRIVE_START + gone, 4), lane, self.style.camera_height),
            (round(pitch, 4), round(yaw, 4), round(roll, 4)),
        )


class TownBuilder:
    """Adds things to a town and numbers them."""

    def __init__(self, style: TownStyle, seed: int) -> None:
        self.town = Town(style)
        self.style = style
        self.plan = style.plan
        self.rng = np.random.default_rng([style.seed, seed])
        # CARLA's numbers are the low 16 bits of something large: any, but distinct.
        self._numbers = iter(self.rng.permutation(np.arange(1, 65536)).tolist())

        self._grown: dict[TreeKind, list[tuple[Mesh, Mesh]]] = {}

    def put(self, thing: Thing) -> None:
        """Add a thing and give it the next number."""
        self.town.things.append(replace(thing, instance=next(self._numbers)))

    def scenery(
        self,
        mesh: Mesh,
        x: float,
        y: float,
        yaw: float = 0.0,
        *,
        z: float = SIDEWALK_HEIGHT,
    ) -> None:
        """Add an object for which CARLA has no box."""
        start = Transform((x, y, z), (0.0, yaw, 0.0))
        self.put(Thing(0, SCENERY, "static.prop.mesh", "", (mesh,), start))

    def prototype(self, kind: TreeKind) -> tuple[Mesh, Mesh]:
        """One of a few trees of a species, near and from afar; they share meshes."""
        grown = self._grown.setdefault(kind, [])
        if len(grown) < 3:
            seed = int(self.rng.integers(1 << 30))
            near, far = (
                tree(kind, np.random.default_rng(seed), d) for d in (0.7, 0.13)
            )
            grown.append((near, far))
            return grown[-1]
        return self.pick(grown)

    def thin_out(self, share: float) -> None:
        """Keep about a share of the things with a box, and all of the scenery."""
        things = self.town.things
        stays = self.rng.random(len(things)) < share
        self.town.things = [
            thing
            for thing, chosen in zip(things, stays, strict=True)
            if chosen or not thing.has_box
        ]

    def pick(self, choices: Sequence[T]) -> T:
        """One of several, at random."""
        return choices[int(self.rng.integers(len(choices)))]

    def stretches(self) -> list[tuple[float, float]]:
        """The x ranges between the side streets."""
        half = self.plan.side_half_width
        starts = [TOWN_START, *(middle + half for middle in self.plan.crossings)]
        ends = [*(middle - half for middle in self.plan.crossings), TOWN_END]
        return list(zip(starts, ends, strict=True))


@dataclass(frozen=True)
class Route:
    """A way straight on at one speed, which begins again at its end.

    `speed` is in metres per second, along the heading. After `length` metres the start
    comes again; 0 stands still. `ahead` are metres already gone at time 0, `sway` those
    that it falls back and catches up, again and again.
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
    def hides(self) -> bool:
        """Whether it is a house: large, and nothing can be seen through it."""
        return self.type_id == HOUSE_TYPE

    @property
    def has_box(self) -> bool:
        """Whether CARLA has a box for it."""
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
        """The pose of the thing at a time, in seconds."""
        if not self.route.length:
            return self.start
        yaw = np.radians(self.start.rotation[1])
        gone = self.route.gone(time_s)
        x, y, z = self.start.location
        place = (x + gone * float(np.cos(yaw)), y + gone * float(np.sin(yaw)), z)
        return replace(self.start, location=place)

    def shape(self, time_s: float, *, far: bool = False) -> Mesh:
        """Its shape at a time."""
        shapes = self.far_shapes if far and self.far_shapes else self.shapes
        if len(shapes) == 1:
            return shapes[0]
        step = int(time_s / self.shape_s) + self.shape_offset
        return shapes[step % len(shapes)]


def convoy(gap: float, y: float, sway: float = 0.0) -> tuple[Transform, Route]:
    """Start and route of a thing that keeps about the same distance from the camera."""
    start = Transform((DRIVE_START + gap, y, 0.0))
    return start, Route(DRIVE_SPEED, DRIVE_LENGTH, sway=sway)
