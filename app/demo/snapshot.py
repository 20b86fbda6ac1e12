"""What a camera sees of a town at one moment, as one heap of triangles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from app.demo.mesh import Mesh, join, turned
from app.demo.paint import Kind
from app.demo.rasteriser import Canvas, draw
from app.demo.town import Town
from app.demo.view import NEAR, to_homogeneous, to_screen
from filter_core.geometry.camera import Camera
from filter_core.geometry.pose import Transform
from filter_core.types import BoolArray, FloatArray, IntArray

_FAR_M: Final = 42.0
"""From here on, things are drawn in their coarser shape if they have one."""
_TILE: Final = 16


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Triangles in the world and on the screen, and whose they are.

    Attributes
    ----------
    camera : Camera
    mesh : Mesh of T triangles
    owner : (T,) int32, index into the town's things
    screen : (S, 3, 3), per corner u px, v px, 1 / depth
    source : (S,) the triangle that each of them comes from
    """

    camera: Camera
    mesh: Mesh
    owner: NDArray[np.int32]
    screen: FloatArray
    source: IntArray


class Stage:
    """A town's things, prepared for taking many snapshots."""

    def __init__(self, town: Town) -> None:
        self.town = town
        self._centre = np.array([thing.box[0] for thing in town.things])
        self._reach = np.array([thing.reach for thing in town.things])
        self._hides = np.array([thing.hides for thing in town.things])

    def poses(self, time_s: float) -> list[Transform]:
        """Where each thing is."""
        return [thing.pose(time_s) for thing in self.town.things]

    def snapshot(self, camera: Camera, time_s: float) -> Snapshot:
        """All things that the camera may see.

        Houses are drawn first; what lies wholly behind them is left out.
        """
        matrices = np.array([pose.matrix for pose in self.poses(time_s)])
        centres = np.einsum("nij,nj->ni", matrices[:, :3, :3], self._centre)
        centres += matrices[:, :3, 3]
        in_view = _in_view(centres, self._reach, camera)
        distance = np.linalg.norm(centres - camera.position, axis=1)

        def collected(chosen: IntArray) -> Snapshot:
            parts = []
            for one in chosen:
                far = bool(distance[one] > _FAR_M)
                shape = self.town.things[one].shape(time_s, far=far)
                parts.append(shape.placed(matrices[one]))
            owner = np.repeat(chosen, [len(part) for part in parts])
            return _projected(join(parts), owner.astype(np.int32), camera)

        houses = collected(np.flatnonzero(in_view & self._hides))
        canvas = Canvas.blank(camera.width, camera.height)
        draw(canvas, houses.screen, houses.source)
        others = np.flatnonzero(in_view & ~self._hides)
        hidden = _hidden(canvas, centres[others], self._reach[others], camera)
        return _together(houses, collected(others[~hidden]))


def _projected(mesh: Mesh, owner: NDArray[np.int32], camera: Camera) -> Snapshot:
    two_sided = mesh.surface[:, 5] == Kind.LEAF
    screen, source = to_screen(mesh.corners, mesh.normals, camera, two_sided)
    return Snapshot(camera, mesh, owner, screen, source)


def _together(one: Snapshot, two: Snapshot) -> Snapshot:
    return Snapshot(
        one.camera,
        join([one.mesh, two.mesh]),
        np.concatenate([one.owner, two.owner]),
        np.concatenate([one.screen, two.screen]),
        np.concatenate([one.source, two.source + len(one.mesh)]),
    )


def _in_view(centres: FloatArray, reach: FloatArray, camera: Camera) -> BoolArray:
    """Which balls reach into the view's pyramid."""
    image = camera.world_to_image
    planes = np.stack(
        [
            image[0],
            camera.width * image[2] - image[0],
            image[1],
            camera.height * image[2] - image[1],
            image[2],
        ]
    )
    height = centres @ planes[:, :3].T + planes[:, 3]
    radius = reach[:, None] * np.linalg.norm(planes[:, :3], axis=1)
    inside: BoolArray = (height > -radius).all(axis=1)
    return inside


def _hidden(
    canvas: Canvas, centres: FloatArray, reach: FloatArray, camera: Camera
) -> BoolArray:
    """Which balls lie wholly behind what is drawn."""
    tiles = _farthest_per_tile(canvas)
    low, high, nearest = _windows(centres, reach, camera)
    hidden = np.zeros(len(centres), dtype=bool)
    for one in np.flatnonzero(nearest > NEAR):
        rows = slice(int(low[one, 1]) // _TILE, int(high[one, 1]) // _TILE + 1)
        columns = slice(int(low[one, 0]) // _TILE, int(high[one, 0]) // _TILE + 1)
        hidden[one] = tiles[rows, columns].min(initial=np.inf) > 1 / nearest[one]
    return hidden


def _farthest_per_tile(canvas: Canvas) -> NDArray[np.float32]:
    height, width = canvas.nearness.shape
    rows, columns = height // _TILE, width // _TILE
    tiled = canvas.nearness.reshape(rows, _TILE, columns, _TILE)
    farthest: NDArray[np.float32] = tiled.min(axis=(1, 3))
    return farthest


def _windows(
    centres: FloatArray, reach: FloatArray, camera: Camera
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rectangles in the image that balls stay within, and their nearest depths."""
    local = turned(centres - camera.position, camera.world_to_camera[:3, :3])
    focal = camera.intrinsic[0, 0]
    depth, radius = local[:, :1], reach[:, None]
    flat = np.stack([local[:, 1], -local[:, 2]], axis=1)
    near, far = np.maximum(depth - radius, NEAR), np.maximum(depth + radius, NEAR)
    low = np.minimum((flat - radius) / near, (flat - radius) / far) * focal
    high = np.maximum((flat + radius) / near, (flat + radius) / far) * focal
    middle = np.array([camera.width, camera.height]) / 2
    last = np.array([camera.width, camera.height]) - 1.0
    inside = (np.clip(edge + middle, 0, last) for edge in (low, high))
    first, end = inside
    return first, end, (depth - radius)[:, 0]


def homogeneous_corners(snapshot: Snapshot, triangles: IntArray) -> FloatArray:
    """(N, 3, 3): corners of some triangles as (u depth, v depth, depth)."""
    return to_homogeneous(snapshot.mesh.corners[triangles], snapshot.camera)
