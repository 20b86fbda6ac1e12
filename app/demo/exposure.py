"""One frame's planes: which surface each pixel shows, how far it is, what it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from app.demo.ground import RoadPlan, ground_footprint
from app.demo.paint import SURFACE_COLUMNS, Kind, Tag
from app.demo.rasteriser import Canvas, draw
from app.demo.shading import Pixels, smooth_normals
from app.demo.snapshot import Snapshot
from app.demo.textures import Float32
from app.demo.view import to_screen
from filter_core.camera import Camera
from filter_core.types import IntArray, TagImage

SKY_DEPTH: Final = 1000.0
"""Metres: what CARLA's depth camera says of the sky."""
_GROUND: Final = -2
_HORIZON: Final = 900.0
_ROAD_GLOSS: Final = 0.012


@dataclass(frozen=True, eq=False)
class Planes:
    """What each pixel of a frame shows; every plane tells of the same nearest surface.

    Attributes
    ----------
    depth : (H, W) float32, metres along the camera's axis
    tags : (H, W) uint8
    owner : (H, W) int32
        Index of the thing; -1 for sky and ground.
    """

    depth: Float32
    tags: TagImage
    owner: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Exposure:
    """Planes, and what shading needs of the pixels that are not sky."""

    planes: Planes
    pixels: Pixels
    solid: IntArray
    """(N,) flat indices of `pixels`."""
    rays: Float32
    """(H W, 3): world directions, one metre deep."""


def expose(snapshot: Snapshot, camera: Camera, plan: RoadPlan) -> Exposure:
    """Find the nearest surface of every pixel."""
    mesh = snapshot.mesh
    two_sided = mesh.surface[:, 5] == Kind.LEAF
    screen, source = to_screen(mesh.corners, mesh.normals, camera, two_sided)
    rays = _rays(camera)
    canvas = _ground_canvas(rays, camera)
    draw(canvas, screen, source)
    nearness, winner = canvas.nearness.reshape(-1), canvas.winner.reshape(-1)
    solid = np.flatnonzero(winner != -1)
    depth = np.full(len(winner), SKY_DEPTH, dtype=np.float32)
    depth[solid] = 1 / nearness[solid]
    pixels, ground_tags = _pixels(
        snapshot, camera, plan, (solid, winner[solid], depth, rays)
    )
    tags = np.full(len(winner), Tag.SKY, dtype=np.uint8)
    owner = np.full(len(winner), -1, dtype=np.int32)
    on_thing = winner >= 0
    tags[on_thing] = mesh.tag[winner[on_thing]]
    owner[on_thing] = snapshot.owner[winner[on_thing]]
    tags[winner == _GROUND] = ground_tags
    shape = canvas.winner.shape
    planes = Planes(depth.reshape(shape), tags.reshape(shape), owner.reshape(shape))
    return Exposure(planes, pixels, solid, rays)


def _rays(camera: Camera) -> Float32:
    """(H W, 3): forward + right u + up v, without a product per pixel."""
    focal = camera.intrinsic[0, 0]
    forward, right, up = camera.world_to_camera[:3, :3]
    u = (np.arange(camera.width) + 0.5 - camera.width / 2) / focal
    v = (camera.height / 2 - np.arange(camera.height) - 0.5) / focal
    across = (forward + u[:, None] * right).astype(np.float32)
    down = (v[:, None] * up).astype(np.float32)
    return np.asarray((down[:, None] + across).reshape(-1, 3))


def _ground_canvas(rays: Float32, camera: Camera) -> Canvas:
    """A canvas that shows the level ground up to the horizon."""
    canvas = Canvas.blank(camera.width, camera.height)
    nearness = (-rays[:, 2] / np.float32(camera.position[2])).reshape(
        canvas.winner.shape
    )
    on_ground = nearness > 1 / _HORIZON
    canvas.nearness[on_ground] = nearness[on_ground]
    canvas.winner[on_ground] = _GROUND
    return canvas


def _pixels(
    snapshot: Snapshot,
    camera: Camera,
    plan: RoadPlan,
    seen: tuple[IntArray, NDArray[np.int32], Float32, Float32],
) -> tuple[Pixels, TagImage]:
    solid, winner, all_depth, all_rays = seen
    mesh, depth, rays = snapshot.mesh, all_depth[solid], all_rays[solid]
    ground = np.flatnonzero(winner == _GROUND)
    triangle = np.maximum(winner, 0)
    position = camera.position.astype(np.float32) + rays * depth[:, None]
    stretch = np.sqrt(np.einsum("ij,ij->i", rays, rays))
    direction = rays / stretch[:, None]
    size = depth / np.float32(camera.intrinsic[0, 0])
    normal = _normals(snapshot, camera, triangle, solid)
    normal[ground] = (0.0, 0.0, 1.0)
    surface = mesh.surface[triangle]
    footprint = ground_footprint(direction[ground], size[ground])
    tags, albedo = plan.look(position[ground, 0], position[ground, 1], footprint)
    paint = np.zeros((len(ground), SURFACE_COLUMNS), dtype=np.float32)
    paint[:, :3], paint[:, 3] = albedo, _ROAD_GLOSS
    surface[ground] = paint
    return Pixels(position, direction, depth * stretch, normal, surface, size), tags


def _normals(
    snapshot: Snapshot, camera: Camera, triangle: NDArray[np.int32], solid: IntArray
) -> Float32:
    mesh = snapshot.mesh
    shown = np.zeros(len(mesh), dtype=bool)
    shown[triangle] = True
    numbers = np.flatnonzero(shown)
    corner = mesh.normals[numbers]
    bent = np.zeros(len(mesh), dtype=bool)
    spread = np.abs(corner[:, 1:] - corner[:, :1]).reshape(-1, 6)
    bent[numbers] = spread.sum(axis=1) > 1e-6
    normal = mesh.normals[:, 0].astype(np.float32)[triangle]
    chosen = np.flatnonzero(bent[triangle])
    row, column = np.divmod(solid[chosen], camera.width)
    uv = (np.stack([column, row], axis=1) + 0.5).astype(np.float32)
    normal[chosen] = smooth_normals(mesh, camera, triangle[chosen], uv, normal[chosen])
    return normal
