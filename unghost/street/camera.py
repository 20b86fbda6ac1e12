"""Renders a town at one moment: depth, tags and normals, and the colour image.

A `Stage` makes `VisibleTriangles`: all triangles that may be visible, projected to the
screen. Sampled at the pixels' centres, they give the planes of a frame (depth, tag and
normal of each pixel) and its colour image, with smooth edges and sensor noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import BoolArray, FloatArray, IntArray, TagImage
from filter_core.geometry.camera import Camera
from filter_core.geometry.pose import Transform
from unghost.street.ground import RoadPlan, ground_footprint
from unghost.street.light import (
    Lighting,
    Pixels,
    ambient_occlusion,
    develop,
    shade,
    sky_with_clouds,
)
from unghost.street.mesh import Mesh, cross, join, turned
from unghost.street.paint import (
    SURFACE_COLUMNS,
    TILE,
    Float32,
    SurfaceKind,
    Tag,
    f32,
    grain_tile,
)
from unghost.street.raster import NEAR, Canvas, draw, to_homogeneous, to_screen
from unghost.street.town import Town

_FAR_M: Final = 42.0
"""Distance from which on things are drawn in their coarser shape, if they have one."""
_TILE: Final = 16
SKY_DEPTH: Final = 1000.0
"""Metres: the depth of the sky in CARLA's depth camera."""
SKY: Final = -1
GROUND: Final = -2
_HORIZON: Final = 900.0
_ROAD_GLOSS: Final = 0.012
_NOISE: Final = 1.1
"""Standard deviation of the sensor's noise, in levels of 255."""
_SMOOTHING: Final = np.array([0.2, 0.6, 0.2], dtype=np.float32)
"""How edges are smoothed, along each axis: as a lens does."""
_SAMPLES_AT_ONCE: Final = 1 << 16


class Stage:
    """The things of a town, prepared once for pictures at many moments."""

    def __init__(self, town: Town) -> None:
        self.town = town
        self._centre = np.array([thing.box[0] for thing in town.things])
        self._reach = np.array([thing.reach for thing in town.things])
        self._hides = np.array([thing.hides for thing in town.things])

    def poses(self, time_s: float) -> list[Transform]:
        """Where each thing is."""
        return [thing.pose(time_s) for thing in self.town.things]

    def visible_triangles(self, camera: Camera, time_s: float) -> VisibleTriangles:
        """All things that the camera may see.

        Houses are drawn first; what lies wholly behind them is left out.
        """
        matrices = np.array([pose.matrix for pose in self.poses(time_s)])
        centres = np.einsum("nij,nj->ni", matrices[:, :3, :3], self._centre)
        centres += matrices[:, :3, 3]
        in_view = _in_view(centres, self._reach, camera)
        distance = np.linalg.norm(centres - camera.position, axis=1)

        canvas = Canvas.blank(camera.width, camera.height)

        def drawn(chosen: IntArray, first: int) -> tuple[Mesh, NDArray[np.int32]]:
            """The triangles of things, which are numbered from `first`, and whose."""
            parts = []
            for index in chosen:
                far = bool(distance[index] > _FAR_M)
                shape = self.town.things[index].shape(time_s, far=far)
                parts.append(shape.placed(matrices[index]))
            mesh = join(parts)
            owner = np.repeat(chosen, [len(part) for part in parts]).astype(np.int32)
            two_sided = mesh.surface[:, 5] == SurfaceKind.LEAF
            screen, source = to_screen(mesh.corners, mesh.normals, camera, two_sided)
            draw(canvas, screen, source + first)
            return mesh, owner

        houses, owner = drawn(np.flatnonzero(in_view & self._hides), 0)
        others = np.flatnonzero(in_view & ~self._hides)
        hidden = _hidden(canvas, centres[others], self._reach[others], camera)
        rest, owner_of_rest = drawn(others[~hidden], len(houses))
        owner = np.concatenate([owner, owner_of_rest])
        return VisibleTriangles(camera, join([houses, rest]), owner, canvas)


@dataclass(frozen=True, eq=False)
class VisibleTriangles:
    """Triangles that a camera may see at one moment, in the world and on the screen.

    Attributes
    ----------
    mesh : Mesh of T triangles
    owner : (T,) int32, index into the town's things
    canvas : which of them is nearest in the middle of each pixel, and its 1 / depth
    """

    camera: Camera
    mesh: Mesh
    owner: NDArray[np.int32]
    canvas: Canvas


def _in_view(centres: FloatArray, reach: FloatArray, camera: Camera) -> BoolArray:
    """(N,) bool: which balls reach into the pyramid that the camera sees."""
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
    """(N,) bool: which balls lie wholly behind what is drawn already."""
    height, width = canvas.nearness.shape
    tiled = canvas.nearness.reshape(height // _TILE, _TILE, width // _TILE, _TILE)
    tiles: NDArray[np.float32] = tiled.min(axis=(1, 3))  # the farthest of each
    low, high, nearest = _windows(centres, reach, camera)
    hidden = np.zeros(len(centres), dtype=bool)
    for ball in np.flatnonzero(nearest > NEAR):
        rows = slice(int(low[ball, 1]) // _TILE, int(high[ball, 1]) // _TILE + 1)
        columns = slice(int(low[ball, 0]) // _TILE, int(high[ball, 0]) // _TILE + 1)
        hidden[ball] = tiles[rows, columns].min(initial=np.inf) > 1 / nearest[ball]
    return hidden


def _windows(
    centres: FloatArray, reach: FloatArray, camera: Camera
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """For each ball, a rectangle in the image that holds it, and its nearest depth."""
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
        """The chosen samples, by their indices, in the order of `chosen`."""
        return Samples(
            self.uv[chosen], self.winner[chosen], self.depth[chosen], self.rays[chosen]
        )


def sampled(visible: VisibleTriangles) -> Samples:
    """Samples in the middle of every pixel."""
    camera = visible.camera
    rows, columns = camera.height, camera.width
    u, v = np.arange(columns) + 0.5, np.arange(rows) + 0.5
    rays = _rays(camera, u, v)
    # The level ground, up to the horizon
    plane = -rays[:, 2] / np.float32(camera.position[2])
    nearness = visible.canvas.nearness.reshape(-1)
    on_ground = (plane > 1 / _HORIZON) & (plane >= nearness)
    nearness = np.where(on_ground, plane, nearness)
    winner = np.where(on_ground, np.int32(GROUND), visible.canvas.winner.reshape(-1))
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


@dataclass(frozen=True, eq=False)
class Planes:
    """The nearest surface at each pixel of a frame, as arrays.

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


def planes_of(
    visible: VisibleTriangles, samples: Samples, tags: TagImage, normals: Float32
) -> Planes:
    """The samples at the centres of all pixels, as arrays of the image's shape."""
    owner = np.full(len(samples.winner), -1, dtype=np.int32)
    on_thing = samples.winner >= 0
    owner[on_thing] = visible.owner[samples.winner[on_thing]]
    shape = (visible.camera.height, visible.camera.width)
    return Planes(
        samples.depth.reshape(shape),
        tags.reshape(shape),
        owner.reshape(shape),
        normals.reshape(*shape, 3),
    )


def surfaces(
    visible: VisibleTriangles, samples: Samples, plan: RoadPlan
) -> tuple[Pixels, TagImage]:
    """The samples that do not show the sky, as input of shading, and their tags."""
    camera, mesh = visible.camera, visible.mesh
    ground = np.flatnonzero(samples.winner == GROUND)
    triangle = np.maximum(samples.winner, 0)
    stretch = np.sqrt(np.einsum("ij,ij->i", samples.rays, samples.rays))
    direction = samples.rays / stretch[:, None]
    position = f32(camera.position) + samples.rays * samples.depth[:, None]
    size = samples.depth / np.float32(camera.intrinsic[0, 0])
    normal = sample_normals(visible, triangle, samples.uv)
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


def sample_normals(
    visible: VisibleTriangles, triangle: NDArray[np.int32], uv: Float32
) -> Float32:
    """(N, 3) float32: normals of the triangles at places (N, 2) on the screen."""
    normals = visible.mesh.normals
    flat = f32(normals[triangle, 0])
    numbers, which = _numbered(triangle, len(normals))
    corner = normals[numbers]
    # Of the triangles in use, those whose corners have different normals are bent.
    spread = np.abs(corner[:, 1:] - corner[:, :1]).reshape(-1, 6).sum(axis=1)
    chosen = np.flatnonzero((spread > 1e-6)[which])
    flat[chosen] = _smooth(visible, triangle[chosen], uv[chosen], flat[chosen])
    return flat


def _smooth(
    visible: VisibleTriangles, triangle: NDArray[np.int32], uv: Float32, flat: Float32
) -> Float32:
    """A normal divided by the depth is linear on the screen.

    So three coefficients per axis and triangle say it for every sample.
    """
    unique, which = _numbered(triangle, len(visible.mesh))
    rows = to_homogeneous(visible.mesh.corners[unique], visible.camera)
    a, b, c = rows[:, 0], rows[:, 1], rows[:, 2]
    inverse = np.stack([cross(b, c), cross(c, a), cross(a, b)], axis=2)
    volume = np.einsum("ni,ni->n", a, cross(b, c))
    sound = np.abs(volume) > 1e-9
    inverse /= np.where(sound, volume, 1.0)[:, None, None]
    slope = np.einsum("nij,njk->nik", inverse, visible.mesh.normals[unique])
    per_sample = slope.astype(np.float32).reshape(-1, 9)[which]
    normals = per_sample[:, :3] * uv[:, :1]
    normals += per_sample[:, 3:6] * uv[:, 1:]
    normals += per_sample[:, 6:]
    length = np.sqrt(np.einsum("ij,ij->i", normals, normals))[:, None]
    good = sound[which] & (length[:, 0] > 1e-12)
    return np.where(good[:, None], normals / np.maximum(length, 1e-12), flat)


def _numbered(
    numbers: NDArray[np.int32] | IntArray, count: int
) -> tuple[IntArray, IntArray]:
    """The numbers below `count` that occur, and where each of `numbers` is among them.

    As `np.unique` with its inverse, without sorting.
    """
    used = np.zeros(count, dtype=bool)
    used[numbers] = True
    unique = np.flatnonzero(used)
    place = np.zeros(count, dtype=np.int64)
    place[unique] = np.arange(len(unique))
    return unique, place[numbers]


class Photographer:
    """Takes the colour image of a town at one moment."""

    def __init__(
        self, visible: VisibleTriangles, plan: RoadPlan, light: Lighting
    ) -> None:
        self._visible, self._plan, self._light = visible, plan, light

    def photograph(
        self, samples: Samples, noise_seed: int
    ) -> tuple[NDArray[np.uint8], Planes]:
        """(H, W, 3) RGB and the planes, from the pixels' centres."""
        camera = self._visible.camera
        height, width = camera.height, camera.width
        depth = samples.depth.reshape(height, width)
        open_sky = ambient_occlusion(depth, float(camera.intrinsic[0, 0])).reshape(-1)
        light, tags, normals = self._shoot(samples, open_sky)
        exposure = self._light.daylight.exposure
        linear = light.reshape(height, width, 3)
        # Smooth edges: pixels beside another triangle take of their neighbours.
        winner = samples.winner.reshape(height, width)
        edge = np.zeros((height, width), dtype=bool)
        for before, after in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
            differs = winner[before] != winner[after]
            edge[before] |= differs
            edge[after] |= differs
        linear[edge] = cv2.sepFilter2D(linear, -1, _SMOOTHING, _SMOOTHING)[edge]
        # Bloom: light brighter than white is spread over neighbouring pixels.
        small = cv2.resize(linear, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
        over = np.clip(small - np.float32(0.9 / exposure), 0, 3)
        spilt = cv2.resize(cv2.GaussianBlur(over, (0, 0), 6), (width, height))
        linear = np.asarray(linear + 0.16 * spilt)
        # The sensor's noise
        rng = np.random.default_rng(noise_seed)
        tiles = (-(-height // TILE) + 1, -(-width // TILE) + 1)
        row, column = rng.integers(TILE, size=2)
        window = np.s_[row : row + height, column : column + width]
        noise = np.tile(grain_tile(71), tiles)[window] * np.float32(_NOISE)
        noisy = develop(linear, exposure) + noise[..., None]
        image = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        return image, planes_of(self._visible, samples, tags, normals)

    def _shoot(
        self, samples: Samples, open_sky: Float32
    ) -> tuple[Float32, TagImage, Float32]:
        """Linear light (N, 3), tags (N,) and normals (N, 3), zero for the sky.

        `open_sky` (N,) is the samples' share of the sky's light.
        """
        count = len(samples.winner)
        light = np.empty((count, 3), dtype=np.float32)
        all_tags = np.full(count, Tag.SKY, dtype=np.uint8)
        normals = np.zeros((count, 3), dtype=np.float32)
        sky = np.flatnonzero(samples.winner == SKY)
        towards = samples.rays[sky]
        towards = towards / np.linalg.norm(towards, axis=1, keepdims=True)
        light[sky] = sky_with_clouds(self._light.daylight, towards)
        solid = np.flatnonzero(samples.winner != SKY)
        # In pieces that fit into the processor's cache.
        for begin in range(0, len(solid), _SAMPLES_AT_ONCE):
            piece = solid[begin : begin + _SAMPLES_AT_ONCE]
            pixels, tags = surfaces(self._visible, samples.part(piece), self._plan)
            all_tags[piece], normals[piece] = tags, pixels.normal
            light[piece] = shade(pixels, open_sky[piece], self._light)
        return light, all_tags, normals
