"""What a camera may see of a town at one moment, as one heap of triangles."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from app.demo.mesh import Mesh, join
from app.demo.things import Thing
from app.demo.town import Town
from filter_core.camera import Camera
from filter_core.pose import Transform
from filter_core.types import BoolArray, FloatArray

_FAR_M = 55.0
"""From here on, things are drawn in their coarser shape if they have one."""


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Triangles in the world and whose they are.

    Attributes
    ----------
    mesh : Mesh
    owner : (T,) int32, index into the town's things
    """

    mesh: Mesh
    owner: NDArray[np.int32]


class Stage:
    """A town's things, prepared for taking many snapshots."""

    def __init__(self, town: Town) -> None:
        self.town = town
        self._centre = np.array([thing.box[0] for thing in town.things])
        self._reach = np.array([thing.reach for thing in town.things])

    @cached_property
    def still(self) -> list[Thing]:
        """What never moves, traffic lights included."""
        return [thing for thing in self.town.things if not thing.route.length]

    def poses(self, time_s: float) -> list[Transform]:
        """Where each thing is."""
        return [thing.pose(time_s) for thing in self.town.things]

    def snapshot(self, camera: Camera, time_s: float) -> Snapshot:
        """All things that reach into the camera's view."""
        matrices = np.array([pose.matrix for pose in self.poses(time_s)])
        centres = np.einsum("nij,nj->ni", matrices[:, :3, :3], self._centre)
        centres += matrices[:, :3, 3]
        seen = np.flatnonzero(_in_view(centres, self._reach, camera))
        distance = np.linalg.norm(centres - camera.position, axis=1)
        parts = [
            _shape(self.town.things[one], time_s, float(distance[one])).placed(
                matrices[one]
            )
            for one in seen
        ]
        owner = np.repeat(seen, [len(part) for part in parts])
        return Snapshot(join(parts), owner.astype(np.int32))


def corners_of(things: list[Thing], time_s: float = 0.0) -> FloatArray:
    """(T, 3, 3): all triangles of some things, in the world."""
    parts = [thing.shape(time_s).placed(thing.pose(time_s).matrix) for thing in things]
    return join(parts).corners


def _shape(thing: Thing, time_s: float, distance: float) -> Mesh:
    if thing.far_shape is not None and distance > _FAR_M:
        return thing.far_shape
    return thing.shape(time_s)


def _in_view(centres: FloatArray, reach: FloatArray, camera: Camera) -> BoolArray:
    """Which balls reach into the view's pyramid."""
    image = camera.world_to_image
    planes = np.stack(
        [
            image[0], camera.width * image[2] - image[0],
            image[1], camera.height * image[2] - image[1],
            image[2],
        ]
    )  # fmt: skip
    height = centres @ planes[:, :3].T + planes[:, 3]
    radius = reach[:, None] * np.linalg.norm(planes[:, :3], axis=1)
    inside: BoolArray = (height > -radius).all(axis=1)
    return inside
