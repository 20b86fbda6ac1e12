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
from unghost.street.mesh import Mesh, cross, dot, join, turned
from unghost.street.paint import (
    TILE,
    Float32,
    SurfaceKind,
    Tag,
    column,
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
    uv : (2, N) px
    winner : (N,) int32, a triangle, `GROUND` or `SKY`
    depth : (N,) metres
    rays : (3, N) world directions, one metre deep
    """

    uv: Float32
    winner: NDArray[np.int32]
    depth: Float32
    rays: Float32

    def part(self, chosen: IntArray) -> Samples:
        """The chosen samples, by their indices, in the order of `chosen`."""
        return Samples(
            np.take(self.uv, chosen, axis=1),
            self.winner[chosen],
            self.depth[chosen],
            np.take(self.rays, chosen, axis=1),
        )


def sampled(visible: VisibleTriangles) -> Samples:
    """Samples in the middle of every pixel."""
    camera = visible.camera
    rows, columns = camera.height, camera.width
    u, v = np.arange(columns) + 0.5, np.arange(rows) + 0.5
    rays = _rays(camera, u, v)
    # The level ground, up to the horizon
    plane = -rays[2] / np.float32(camera.position[2])
    nearness = visible.canvas.nearness.reshape(-1)
    on_ground = (plane > 1 / _HORIZON) & (plane >= nearness)
    nearness = np.where(on_ground, plane, nearness)
    winner = np.where(on_ground, np.int32(GROUND), visible.canvas.winner.reshape(-1))
    depth = np.full(len(winner), SKY_DEPTH, dtype=np.float32)
    solid = np.flatnonzero(winner != SKY)
    depth[solid] = 1 / nearness[solid]
    uv = np.empty((2, rows, columns), dtype=np.float32)
    uv[0], uv[1] = u, v[:, None]
    return Samples(uv.reshape(2, -1), winner, depth, rays)


def _rays(camera: Camera, u: Float32, v: Float32) -> Float32:
    """(3, H W): forward + right u + up v, without a product per pixel."""
    focal = camera.intrinsic[0, 0]
    forward, right, up = camera.world_to_camera[:3, :3]
    across = f32(forward[:, None] + (u - camera.width / 2) / focal * right[:, None])
    down = f32((camera.height / 2 - v) / focal * up[:, None])
    return np.asarray((down[:, :, None] + across[:, None]).reshape(3, -1))


@dataclass(frozen=True, eq=False)
class Planes:
    """The nearest surface at each pixel of a frame, as arrays.

    Attributes
    ----------
    depth : (H, W) float32, metres along the camera's axis
    tags : (H, W) uint8
    owner : (H, W) int32
        Index of the thing; -1 for sky and ground.
    normals : (3, H, W) float32
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
        normals.reshape(3, *shape),
    )


@dataclass(frozen=True, eq=False)
class Facets:
    """The F triangles that are seen somewhere, as input of shading.

    Attributes
    ----------
    surface : (SURFACE_COLUMNS, F)
    tag : (F,) uint8
    normal : (3, F), at the first corner
    is_bent : (F,) bool: whether other corners have other normals
    slope : (9, F)
        The normals of those, divided by the depth, are linear on the screen: how much
        they grow per pixel along u, along v, and what they are at (0, 0).
    """

    surface: Float32
    tag: TagImage
    normal: Float32
    is_bent: BoolArray
    slope: Float32

    @classmethod
    def of(
        cls, visible: VisibleTriangles, winner: NDArray[np.int32]
    ) -> tuple[Facets, NDArray[np.int32]]:
        """The facets, and for each of the winners (N,) which of them it is.

        Where no triangle is seen, that number says nothing.
        """
        mesh, triangle = visible.mesh, np.maximum(winner, 0)
        is_seen = np.zeros(len(mesh), dtype=bool)
        is_seen[triangle] = True
        seen = np.flatnonzero(is_seen)
        place = np.zeros(len(mesh), dtype=np.int32)
        place[seen] = np.arange(len(seen))

        normals = mesh.normals[seen]
        spread = np.abs(normals[:, 1:] - normals[:, :1]).max(axis=(1, 2))
        bent = np.flatnonzero(spread > 1e-6)
        rows = to_homogeneous(mesh.corners[seen[bent]], visible.camera)
        a, b, c = rows[:, 0], rows[:, 1], rows[:, 2]
        inverse = np.stack([cross(b, c), cross(c, a), cross(a, b)], axis=2)
        volume = np.einsum("ni,ni->n", a, cross(b, c))
        sound = np.abs(volume) > 1e-9
        inverse = inverse[sound] / volume[sound, None, None]
        bent = bent[sound]
        is_bent = np.zeros(len(seen), dtype=bool)
        is_bent[bent] = True
        slope = np.zeros((9, len(seen)), dtype=np.float32)
        slope[:, bent] = np.einsum("nij,njk->ikn", inverse, normals[bent]).reshape(
            9, -1
        )
        facets = cls(
            np.ascontiguousarray(mesh.surface[seen].T),
            mesh.tag[seen],
            np.ascontiguousarray(f32(normals[:, 0]).T),
            is_bent,
            slope,
        )
        return facets, place[triangle]

    def normals(self, which: NDArray[np.int32], uv: Float32) -> Float32:
        """(3, N): normals of the facets `which` at places (2, N) on the screen."""
        normals = np.take(self.normal, which, axis=1)
        chosen = np.flatnonzero(self.is_bent[which])
        slope = np.take(self.slope, which[chosen], axis=1)
        u, v = np.take(uv, chosen, axis=1)
        bent = slope[:3] * u + slope[3:6] * v + slope[6:]
        length = np.sqrt(dot(bent, bent))
        good = np.flatnonzero(length > 1e-12)
        normals[:, chosen[good]] = bent[:, good] / length[good]
        return normals


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
        # Smooth edges: pixels beside another triangle take of their neighbours.
        winner = samples.winner.reshape(height, width)
        edge = np.zeros((height, width), dtype=bool)
        for before, after in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
            differs = winner[before] != winner[after]
            edge[before] |= differs
            edge[after] |= differs
        # The sensor's noise
        rng = np.random.default_rng(noise_seed)
        tiles = (-(-height // TILE) + 1, -(-width // TILE) + 1)
        down, right = rng.integers(TILE, size=2)
        window = np.s_[down : down + height, right : right + width]
        noise = np.tile(grain_tile(71), tiles)[window] * np.float32(_NOISE)
        channels = []
        for channel in light.reshape(3, height, width):
            smooth = cv2.sepFilter2D(channel, -1, _SMOOTHING, _SMOOTHING)
            linear = np.where(edge, smooth, channel)
            # Bloom: light brighter than white is spread over neighbouring pixels.
            small = cv2.resize(
                linear, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA
            )
            over = np.clip(small - np.float32(0.9 / exposure), 0, 3)
            spilt = cv2.resize(cv2.GaussianBlur(over, (0, 0), 6), (width, height))
            linear += np.float32(0.16) * spilt
            noisy = develop(linear, exposure) + noise
            channels.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
        image = np.asarray(cv2.merge(channels))
        return image, planes_of(self._visible, samples, tags, normals)

    def _shoot(
        self, samples: Samples, open_sky: Float32
    ) -> tuple[Float32, TagImage, Float32]:
        """Linear light (3, N), tags (N,) and normals (3, N), zero for the sky.

        `open_sky` (N,) is the samples' share of the sky's light.
        """
        count = len(samples.winner)
        light = np.empty((3, count), dtype=np.float32)
        all_tags = np.full(count, Tag.SKY, dtype=np.uint8)
        normals = np.zeros((3, count), dtype=np.float32)
        sky = np.flatnonzero(samples.winner == SKY)
        towards = np.take(samples.rays, sky, axis=1)
        towards /= np.sqrt(dot(towards, towards))
        light[:, sky] = sky_with_clouds(self._light.daylight, towards)
        solid = np.flatnonzero(samples.winner != SKY)
        facets, which = Facets.of(self._visible, samples.winner)
        # In pieces that fit into the processor's cache.
        for begin in range(0, len(solid), _SAMPLES_AT_ONCE):
            piece = solid[begin : begin + _SAMPLES_AT_ONCE]
            pixels, tags = self._surfaces(samples.part(piece), facets, which[piece])
            all_tags[piece], normals[:, piece] = tags, pixels.normal
            light[:, piece] = shade(pixels, open_sky[piece], self._light)
        return light, all_tags, normals

    def _surfaces(
        self, samples: Samples, facets: Facets, which: NDArray[np.int32]
    ) -> tuple[Pixels, TagImage]:
        """Samples that do not show the sky, as input of shading, and their tags."""
        camera, rays = self._visible.camera, samples.rays
        stretch = np.sqrt(dot(rays, rays))
        direction = rays / stretch
        position = column(camera.position) + rays * samples.depth
        size = samples.depth / np.float32(camera.intrinsic[0, 0])
        normal = facets.normals(which, samples.uv)
        surface, tags = np.take(facets.surface, which, axis=1), facets.tag[which]
        ground = np.flatnonzero(samples.winner == GROUND)
        normal[:, ground] = column((0.0, 0.0, 1.0))
        footprint = ground_footprint(direction[:, ground], size[ground])
        x, y = np.take(position[:2], ground, axis=1)
        surface[:, ground] = 0
        tags[ground], surface[:3, ground] = self._plan.look(x, y, footprint)
        surface[3, ground] = _ROAD_GLOSS
        distance = samples.depth * stretch
        return Pixels(position, direction, distance, normal, surface, size), tags
