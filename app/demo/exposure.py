"""One frame's planes: which surface each pixel shows, how far it is, what it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from app.demo.ground import RoadPlan, ground_footprint
from app.demo.normals import sample_normals
from app.demo.paint import SURFACE_COLUMNS
from app.demo.rasteriser import Canvas, draw
from app.demo.shading import Pixels
from app.demo.snapshot import Snapshot
from app.demo.textures import Float32, f32
from filter_core.geometry.camera import Camera
from filter_core.types import IntArray, TagImage

SKY_DEPTH: Final = 1000.0
"""Metres: what CARLA's depth camera says of the sky."""
SKY: Final = -1
GROUND: Final = -2
_HORIZON: Final = 900.0
_ROAD_GLOSS: Final = 0.012


@dataclass(frozen=True, eq=False)
class Samples:
    """N places on the screen and the nearest triangle at each.

    Attributes
    ----------
    uv : (N, 2) px
    winner : (N,) int32, a triangle, `GROUND` or `SKY`
    depth : (N,) metres
    rays : (N, 3) world directions, one metre deep
    """

    uv: Float32
    winner: NDArray[np.int32]
    depth: Float32
    rays: Float32

    def part(self, chosen: IntArray) -> Samples:
        """Some of them."""
        return Samples(
            self.uv[chosen], self.winner[chosen], self.depth[chosen], self.rays[chosen]
        )


@dataclass(frozen=True, eq=False)
class Planes:
    """What each pixel of a frame shows; every plane tells of the same nearest surface.

    Attributes
    ----------
    depth : (H, W) float32, metres along the camera's axis
    tags : (H, W) uint8
    owner : (H, W) int32
        Index of the thing; -1 for sky and ground.
    normals : (H, W, 3) float32
    """

    depth: Float32
    tags: TagImage
    owner: NDArray[np.int32]
    normals: Float32


def pixel_centres(snapshot: Snapshot) -> Samples:
    """The middle of every pixel: what tags, instances and depth are made from."""
    return _sampled(snapshot, 0.5)


def pixel_corners(snapshot: Snapshot) -> Samples:
    """The (H + 1) (W + 1) corners of the pixels, for smoothing the colour image."""
    return _sampled(snapshot, 0.0)


def _sampled(snapshot: Snapshot, offset: float) -> Samples:
    camera = snapshot.camera
    rows, columns = (
        camera.height + (offset == 0),
        camera.width + (offset == 0),
    )
    u, v = np.arange(columns) + offset, np.arange(rows) + offset
    rays = _rays(camera, u, v)
    canvas = Canvas.blank(columns, rows)
    _draw_ground(canvas, rays, camera)
    # The rasteriser samples at half pixels.
    shifted = snapshot.screen + np.array([0.5 - offset, 0.5 - offset, 0.0])
    draw(canvas, shifted, snapshot.source)
    winner, nearness = canvas.winner.reshape(-1), canvas.nearness.reshape(-1)
    depth = np.full(len(winner), SKY_DEPTH, dtype=np.float32)
    solid = np.flatnonzero(winner != SKY)
    depth[solid] = 1 / nearness[solid]
    uv = np.empty((rows, columns, 2), dtype=np.float32)
    uv[..., 0], uv[..., 1] = u, v[:, None]
    return Samples(uv.reshape(-1, 2), winner, depth, rays)


def _rays(camera: Camera, u: Float32, v: Float32) -> Float32:
    """(H W, 3): forward + right u + up v, without a product per pixel."""
    focal = camera.intrinsic[0, 0]
    forward, right, up = camera.world_to_camera[:3, :3]
    across = f32(forward + ((u - camera.width / 2) / focal)[:, None] * right)
    down = f32(((camera.height / 2 - v) / focal)[:, None] * up)
    return np.asarray((down[:, None] + across).reshape(-1, 3))


def _draw_ground(canvas: Canvas, rays: Float32, camera: Camera) -> None:
    """The level ground, up to the horizon."""
    nearness = -rays[:, 2] / np.float32(camera.position[2])
    plane = nearness.reshape(canvas.winner.shape)
    on_ground = plane > 1 / _HORIZON
    canvas.nearness[on_ground] = plane[on_ground]
    canvas.winner[on_ground] = GROUND


def surfaces(
    snapshot: Snapshot, samples: Samples, plan: RoadPlan
) -> tuple[Pixels, TagImage]:
    """What samples that do not show the sky show: for shading, and their tags."""
    camera, mesh = snapshot.camera, snapshot.mesh
    ground = np.flatnonzero(samples.winner == GROUND)
    triangle = np.maximum(samples.winner, 0)
    stretch = np.sqrt(np.einsum("ij,ij->i", samples.rays, samples.rays))
    direction = samples.rays / stretch[:, None]
    position = f32(camera.position) + samples.rays * samples.depth[:, None]
    size = samples.depth / np.float32(camera.intrinsic[0, 0])
    normal = sample_normals(snapshot, triangle, samples.uv)
    normal[ground] = (0.0, 0.0, 1.0)
    surface, tags = mesh.surface[triangle], mesh.tag[triangle]
    footprint = ground_footprint(direction[ground], size[ground])
    x, y = position[ground, 0], position[ground, 1]
    paint = np.zeros((len(ground), SURFACE_COLUMNS), dtype=np.float32)
    tags[ground], paint[:, :3] = plan.look(x, y, footprint)
    paint[:, 3] = _ROAD_GLOSS
    surface[ground] = paint
    distance = samples.depth * stretch
    return Pixels(position, direction, distance, normal, surface, size), tags


def planes_of(
    snapshot: Snapshot, samples: Samples, tags: TagImage, normals: Float32
) -> Planes:
    """Arrange the pixels' centres as images."""
    owner = np.full(len(samples.winner), -1, dtype=np.int32)
    on_thing = samples.winner >= 0
    owner[on_thing] = snapshot.owner[samples.winner[on_thing]]
    shape = (snapshot.camera.height, snapshot.camera.width)
    return Planes(
        samples.depth.reshape(shape),
        tags.reshape(shape),
        owner.reshape(shape),
        normals.reshape(*shape, 3),
    )
