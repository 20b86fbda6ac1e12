"""A town: everything that stands and moves in it, and the drive through it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final, TypeVar

import numpy as np

from app.demo.ground import SIDEWALK_HEIGHT, RoadPlan
from app.demo.mesh import Mesh
from app.demo.sky import Hour
from app.demo.things import SCENERY, Route, Thing
from app.demo.trees import TreeKind, tree
from filter_core.geometry.pose import Transform

T = TypeVar("T")

STEP_S: Final = 1.25
"""Seconds between two frames of a town."""
DRIVE_SPEED: Final = 6.25
DRIVE_START: Final = -38.0
DRIVE_LENGTH: Final = 250.0
TOWN_START: Final = -85.0
TOWN_END: Final = 345.0
BACK_ROW: Final = 36.0
"""From the front of the first row of houses to the front of the second, metres."""
SIDE_END: Final = 92.0
"""Where the side streets end, metres from the main street's middle."""


@dataclass(frozen=True)
class TownStyle:
    """What tells one town from another.

    Attributes
    ----------
    name : of the map
    seed : of everything random in it
    plan, hour : its streets and its light
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
    hour: Hour
    weather: dict[str, float]
    houses: tuple[int, ...]
    storeys: tuple[int, int]
    trees: tuple[TreeKind, ...]
    camera_height: float
    gap_chance: float
    parked: float


@dataclass(eq=False)
class Town:
    """A style made real."""

    style: TownStyle
    things: list[Thing] = field(default_factory=list)

    def camera(self, step: int) -> Transform:
        """Where the camera of a step is: in the right lane, looking a little around."""
        gone = (DRIVE_SPEED * STEP_S * step) % DRIVE_LENGTH
        lane = self.style.plan.lane_middle(0)
        glance = 14.0 * math.sin(2.1 * step) if step % 5 == 3 else 0.0
        yaw = 2.5 * math.sin(0.9 * step) + glance
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
        """Add a thing that is complete but for its number."""
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
        """Add something that CARLA hands out no box for."""
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
        """Leave about a share of what has a box, and all of the scenery."""
        things = self.town.things
        stays = self.rng.random(len(things)) < share
        self.town.things = [
            thing
            for thing, chosen in zip(things, stays, strict=True)
            if chosen or not thing.has_box
        ]

    def pick(self, choices: Sequence[T]) -> T:
        """Any of several."""
        return choices[int(self.rng.integers(len(choices)))]

    def stretches(self) -> list[tuple[float, float]]:
        """The x ranges between the side streets."""
        half = self.plan.side_half_width
        starts = [TOWN_START, *(middle + half for middle in self.plan.crossings)]
        ends = [*(middle - half for middle in self.plan.crossings), TOWN_END]
        return list(zip(starts, ends, strict=True))


def convoy(gap: float, y: float, sway: float = 0.0) -> tuple[Transform, Route]:
    """Start and route of what keeps its distance ahead of the camera, give or take."""
    start = Transform((DRIVE_START + gap, y, 0.0))
    return start, Route(DRIVE_SPEED, DRIVE_LENGTH, sway=sway)
