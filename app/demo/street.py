"""The demo's street: frames with everything that is true about them."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from threading import Lock
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from app.demo.annotation import FIRST_ACTOR, FOV, HEIGHT, WIDTH, annotate, placed_boxes
from app.demo.exposure import Planes, pixel_centres
from app.demo.lidar import npy, scan
from app.demo.photograph import Photographer
from app.demo.planes import encode_depth, encode_instances, paint_tags, png, raw_tags
from app.demo.shading import Lighting
from app.demo.snapshot import Stage
from app.demo.styles import STYLES, build_town
from app.demo.sunlight import ShadowMap
from app.demo.things import Thing
from app.demo.town import SIDE_END, STEP_S, TOWN_END, TOWN_START, Town
from app.demo.truth import truth_of
from filter_core.geometry.camera import Camera
from filter_core.types import FloatArray

_SHADOW_TEXELS: Final = (4096, 4096)
_MOVING_TEXELS: Final = (1536, 1536)
_MOVING_REACH: Final = 55.0
_FLAT_EVERY: Final = 4
"""Every fourth frame of a town has naive rectangles instead of 3D boxes."""
THREADS: Final = 2


@dataclass(frozen=True, eq=False)
class StreetFrame:
    """One frame: what a recording of CARLA would hold, and the truth beside it.

    Attributes
    ----------
    key : such as ``town-a/000012``
    image_png, segmentation_png, instances_png, depth_png : bytes
    lidar_npy : bytes
    annotation : the camera and the boxes
    truth : per box: visible pixels and the kind of ghost; never part of the input
    """

    key: str
    image_png: bytes
    segmentation_png: bytes
    instances_png: bytes
    depth_png: bytes
    lidar_npy: bytes
    annotation: dict[str, Any]
    truth: list[dict[str, Any]]


class StreetScene:
    """Three towns and a drive through each; the same seed gives the same bytes.

    Parameters
    ----------
    seed : int
    raw : bool
        Write raw tags instead of palette colours into the segmentation.
    actors : float
        The share of vehicles, people and lights that are there: all of them crowd the
        street far beyond what is usually recorded.
    """

    def __init__(
        self, seed: int = 0, *, raw: bool = False, actors: float = 1.0
    ) -> None:
        self._seed, self._raw = seed, raw
        self._sets = [_Set(number, seed, actors) for number in range(len(STYLES))]

    def frames(self, count: int, threads: int = THREADS) -> Iterator[StreetFrame]:
        """The first `count` frames, in order; a few are rendered ahead."""
        with ThreadPoolExecutor(threads) as pool:
            pending = [
                pool.submit(self.render_frame, index)
                for index in range(min(count, 2 * threads))
            ]
            for index in range(count):
                frame = pending.pop(0).result()
                following = index + 2 * threads
                if following < count:
                    pending.append(pool.submit(self.render_frame, following))
                yield frame

    def render_frame(self, index: int) -> StreetFrame:
        """One frame; towns take turns."""
        step, number = divmod(index, len(self._sets))
        return self._sets[number].render(step, raw=self._raw)


class _Set:
    """A town with what is computed once for all of its frames."""

    def __init__(self, number: int, seed: int, actors: float) -> None:
        self._number, self._seed, self._actors = number, seed, actors
        self._lock = Lock()

    @cached_property
    def _town(self) -> Town:
        return build_town(STYLES[self._number], self._seed, self._actors)

    @cached_property
    def _stage(self) -> Stage:
        return Stage(self._town)

    @cached_property
    def _still_shadows(self) -> ShadowMap:
        """The shadows of what never moves and may reach the main street."""
        reach = SIDE_END / 2
        area = _box_corners((TOWN_START, -reach, 0.0), (TOWN_END, reach, 10.0))
        near = self._town.style.plan.frontage + 6.0
        still = [
            thing
            for thing in self._town.things
            if not thing.route.length
            and (thing.hides or abs(thing.start.location[1]) < near)
        ]
        return self._shadows(still, area, _SHADOW_TEXELS)

    def _shadows(
        self,
        things: list[Thing],
        area: FloatArray,
        texels: tuple[int, int],
        time_s: float = 0.0,
    ) -> ShadowMap:
        corners = (
            thing.shape(time_s).placed(thing.pose(time_s).matrix).corners
            for thing in things
        )
        return ShadowMap.of(corners, self._town.style.hour.sun, area, texels)

    def render(self, step: int, *, raw: bool) -> StreetFrame:
        with self._lock:
            stage, still = self._stage, self._still_shadows
        style, things = self._town.style, self._town.things
        time_s = step * STEP_S
        pose = self._town.camera(step)
        camera = Camera.from_fov(WIDTH, HEIGHT, FOV, pose)
        snapshot = stage.snapshot(camera, time_s)
        light = Lighting(style.hour, (still, self._moving_shadows(camera, time_s)))
        seed = (self._seed * 31 + self._number) * 100_003 + step
        photographer = Photographer(snapshot, style.plan, light)
        image, planes = photographer.photograph(pixel_centres(snapshot), seed)
        key = f"{style.name}/{step:06d}"
        boxes = placed_boxes(things, stage.poses(time_s), camera)
        flat = step % _FLAT_EVERY == _FLAT_EVERY - 1
        return StreetFrame(
            key=key,
            image_png=png(image),
            segmentation_png=png(
                raw_tags(planes.tags) if raw else paint_tags(planes.tags)
            ),
            instances_png=png(self._instances(planes)),
            depth_png=png(encode_depth(planes.depth)),
            lidar_npy=npy(self._scan(planes, camera)),
            annotation=annotate(style, pose, camera, boxes, flat=flat),
            truth=truth_of(planes, boxes, camera, len(things)),
        )

    def _scan(self, planes: Planes, camera: Camera) -> NDArray[np.void]:
        ids = [FIRST_ACTOR + index for index in range(len(self._town.things))]
        return scan(planes, camera, np.array([*ids, 0]))

    def _instances(self, planes: Planes) -> NDArray[np.uint8]:
        numbers = np.array(
            [*(thing.instance for thing in self._town.things), 0], dtype=np.int32
        )
        return encode_instances(planes.tags, numbers[planes.owner])

    def _moving_shadows(self, camera: Camera, time_s: float) -> ShadowMap:
        x, y, _ = camera.position
        ahead = _MOVING_REACH * 0.6
        area = _box_corners(
            (x + ahead - _MOVING_REACH, y - _MOVING_REACH * 0.6, 0.0),
            (x + ahead + _MOVING_REACH, y + _MOVING_REACH * 0.6, 3.0),
        )
        middle = x + ahead
        near = [
            thing
            for thing in self._town.things
            if thing.route.length
            and abs(thing.pose(time_s).location[0] - middle) < _MOVING_REACH + 10
        ]
        return self._shadows(near, area, _MOVING_TEXELS, time_s)


def _box_corners(low: tuple[float, ...], high: tuple[float, ...]) -> FloatArray:
    return np.array(
        [
            [x, y, z]
            for x in (low[0], high[0])
            for y in (low[1], high[1])
            for z in (low[2], high[2])
        ]
    )
