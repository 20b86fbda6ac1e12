"""The interface of this package: frames of a street, and the truth about them.

`StreetScene` renders frames; `write_street` writes them as a dataset into a folder, a
manifest with its files and the truth. `render_street` does the same in child processes,
in each of which this module is run as a program.
"""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from queue import SimpleQueue
from threading import Lock, Thread
from typing import IO, Final

import numpy as np

from filter_core.arrays import FloatArray
from filter_core.formats.files import write_whole
from filter_core.formats.reading import MANIFEST_NAME
from filter_core.geometry.camera import Camera
from filter_core.local import in_order
from filter_core.processes import module_command
from unghost.street.camera import Photographer, Stage, sampled
from unghost.street.light import Lighting, ShadowMap
from unghost.street.sensors import (
    FIRST_ACTOR,
    FOV,
    HEIGHT,
    WIDTH,
    annotate,
    encode_depth,
    encode_instances,
    npy,
    paint_tags,
    placed_boxes,
    png,
    scan,
    truth_of,
)
from unghost.street.town import SIDE_END, STEP_S, TOWN_END, TOWN_START, Thing, Town
from unghost.street.towns import STYLES, build_town

_SHADOW_TEXELS: Final = (4096, 4096)
"""Of the map of shadows that never move, made once per town."""
_MOVING_TEXELS: Final = (1536, 1536)
"""Of the map of shadows that move, made for each frame around the camera."""
_MOVING_REACH: Final = 55.0
"""Metres from the middle of that map to its ends along the street."""
_FLAT_EVERY: Final = 4
"""Every fourth frame of a town has naive rectangles instead of 3D boxes."""
THREADS: Final = 2
"""Frames that are rendered at the same time."""
TRUTH: Final = "truth.jsonl"
"""The file of a street with the truth about each box."""
RECORDED: Final = 0.22
"""The share of the actors that leaves about 38 boxes a frame, as recordings have."""
_NICE: Final = 10
"""How far processes that render stand back for others, such as the service that shows
their frames."""
_KEEP_MEMORY: Final = {
    "MALLOC_MMAP_THRESHOLD_": str(1 << 28),
    "MALLOC_TRIM_THRESHOLD_": str(1 << 28),
}
"""Lets glibc use the memory of arrays again, which it would return to the kernel."""
_TWICE_FROM: Final = 6
"""Cores from which each town is rendered by two processes."""


@dataclass(frozen=True, eq=False)
class StreetFrame:
    """One frame: the files that a recording of CARLA would have, and the truth.

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
    annotation: dict[str, object]
    truth: list[dict[str, object]]


class StreetScene:
    """Three towns and a drive through each; the same seed gives the same bytes.

    `actors` is the share of vehicles, people and lights that are there, 0 to 1. With
    all of them the street is far more crowded than usual recordings. `flat`: every
    fourth frame has naive rectangles instead of 3D boxes.
    """

    def __init__(
        self, seed: int = 0, *, actors: float = 1.0, flat: bool = True
    ) -> None:
        self._sets = [
            _Set(number, seed, actors, flat=flat) for number in range(len(STYLES))
        ]

    def frames(self, count: int) -> Iterator[StreetFrame]:
        """The first `count` frames, in order; a few are rendered ahead."""
        return in_order(self.render_frame, range(count), THREADS)

    def build_town(self, index: int) -> None:
        """What the frames of one town have in common, before the first is rendered."""
        self._sets[index % len(self._sets)].build()

    def render_frame(self, index: int) -> StreetFrame:
        """One frame; towns take turns."""
        step, number = divmod(index, len(self._sets))
        return self._sets[number].render(step)


class _Set:
    """A town with what is computed once for all of its frames."""

    def __init__(self, number: int, seed: int, actors: float, *, flat: bool) -> None:
        self._number, self._seed, self._actors = number, seed, actors
        self._flat = flat
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
        meshes = (
            thing.shape(time_s).placed(thing.pose(time_s).matrix) for thing in things
        )
        return ShadowMap.of(meshes, self._town.style.daylight.sun, area, texels)

    def build(self) -> tuple[Stage, ShadowMap]:
        with self._lock:
            return self._stage, self._still_shadows

    def render(self, step: int) -> StreetFrame:
        stage, still = self.build()
        style, things = self._town.style, self._town.things
        time_s = step * STEP_S
        pose = self._town.camera(step)
        camera = Camera.from_fov(WIDTH, HEIGHT, FOV, pose)
        visible = stage.visible_triangles(camera, time_s)
        light = Lighting(style.daylight, (still, self._moving_shadows(camera, time_s)))
        seed = (self._seed * 31 + self._number) * 100_003 + step
        photographer = Photographer(visible, style.plan, light)
        image, planes = photographer.photograph(sampled(visible), seed)
        key = f"{style.name}/{step:06d}"
        boxes = placed_boxes(things, stage.poses(time_s), camera)
        flat = self._flat and step % _FLAT_EVERY == _FLAT_EVERY - 1
        actors = range(FIRST_ACTOR, FIRST_ACTOR + len(things))
        instances = np.array([*(thing.instance for thing in things), 0], np.int32)
        return StreetFrame(
            key=key,
            image_png=png(image),
            segmentation_png=png(paint_tags(planes.tags)),
            instances_png=png(encode_instances(planes.tags, instances[planes.owner])),
            depth_png=png(encode_depth(planes.depth)),
            lidar_npy=npy(scan(planes, camera, np.array([*actors, 0]))),
            annotation=annotate(style, pose, camera, boxes, flat=flat),
            truth=truth_of(planes, boxes, camera, len(things)),
        )

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
    return np.array(list(itertools.product(*zip(low, high, strict=True))))


def write_street(
    folder: Path,
    frames: int = 48,
    scene: StreetScene | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Render a street into a folder; returns the path of its manifest.

    The manifest is written last, whole: a folder that has one is complete. The three
    towns take turns; by default they are those of seed 0. `progress` is called after
    each frame with how many are done, and of how many.
    """
    folder.mkdir(parents=True, exist_ok=True)
    manifest: list[dict[str, object]] = []
    truth: list[dict[str, object]] = []
    rendered = (scene or StreetScene()).frames(frames)
    for number, frame in enumerate(rendered, start=1):
        manifest.append(_write_frame(folder, frame))
        truth.extend({"key": frame.key, **line} for line in frame.truth)
        if progress is not None:
            progress(number, frames)
    _write_lines(folder / TRUTH, truth)
    _write_lines(folder / MANIFEST_NAME, manifest)
    return folder / MANIFEST_NAME


def render_street(
    folder: Callable[[], Path], frames: int, seed: int, *, actors: float = RECORDED
) -> Iterator[dict[str, object]]:
    """Render a street into a folder, in child processes that end with this one.

    Yields a line of the manifest as soon as the files of its frame are written; in the
    end the folder has what `write_street` writes. `actors` are as those of
    `StreetScene`. `folder` returns a folder that exists; it is called once, when the
    first processes have begun, and may wait: they build their towns meanwhile.

    Each process renders one town, or every second frame of it. As the first frame of a
    town takes as long as several others, no more processes work on their first one than
    there are cores: so the first frames of all come soon. One core is left to the
    caller until `folder` returns.

    Raises RuntimeError if a process has ended before its frames were rendered.
    """
    cores = os.cpu_count() or 1
    step = len(STYLES) * (2 if cores >= _TWICE_FROM else 1)
    parts = [range(part, frames, step) for part in range(min(step, frames))]
    lines: dict[int, tuple[dict[str, object], list[dict[str, object]]]] = {}
    told: SimpleQueue[tuple[int, bytes]] = SimpleQueue()
    with ExitStack() as running:
        waiting = list(enumerate(parts))
        beginning: set[int] = set()
        place: Path | None = None
        while len(lines) < frames:
            begun: list[IO[bytes] | None] = []
            most = cores if place else max(1, cores - 1)
            while waiting and len(beginning) < most:
                number, part = waiting.pop(0)
                beginning.add(number)
                words = (str(seed), str(actors), *map(str, part))
                child = subprocess.Popen(
                    module_command(__name__, *words),
                    env=os.environ | _KEEP_MEMORY,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                )
                begun.append(child.stdin)
                running.enter_context(child)
                running.callback(child.kill)
                listening = (child.stdout, number, told.put)
                Thread(target=_listen, args=listening, daemon=True).start()
            was_waiting = place is None
            place = place or folder()
            for pipe in filter(None, begun):
                with suppress(BrokenPipeError), pipe:
                    pipe.write(json.dumps(str(place)).encode())
            if was_waiting:
                continue  # with as many processes as there are cores
            number, text = told.get()
            beginning.discard(number)
            if not text:
                if set(parts[number]) - lines.keys():
                    raise RuntimeError("a process that renders the street has died")
                continue
            index, line, truth = json.loads(text)
            lines[index] = line, truth
            yield line
    in_turn = [lines[index] for index in range(frames)]
    truths = ({"key": line["key"], **row} for line, rows in in_turn for row in rows)
    if place is not None:
        _write_lines(place / TRUTH, list(truths))
        _write_lines(place / MANIFEST_NAME, [line for line, _ in in_turn])


def _listen(
    output: IO[bytes], number: int, tell: Callable[[tuple[int, bytes]], None]
) -> None:
    for text in itertools.chain(output, [b""]):
        tell((number, text))


def _render_part(seed: str, actors: str, *indices: str) -> None:
    """The program of a child: it renders these frames and prints a line about each.

    It reads from its input into which folder, after it has built its town.
    """
    if hasattr(os, "nice"):
        os.nice(_NICE)
    scene = StreetScene(int(seed), actors=float(actors))
    scene.build_town(int(indices[0]))
    folder = sys.stdin.read()
    if not folder:  # who started it has ended
        return
    for index in map(int, indices):
        frame = scene.render_frame(index)
        line = _write_frame(Path(json.loads(folder)), frame)
        sys.stdout.write(json.dumps([index, line, frame.truth]) + "\n")
        sys.stdout.flush()


def _write_frame(folder: Path, frame: StreetFrame) -> dict[str, object]:
    paths = {}
    for name, place, suffix, data in (
        ("image", "rgb", ".png", frame.image_png),
        ("segmentation", "seg", ".png", frame.segmentation_png),
        ("instances", "instances", ".png", frame.instances_png),
        ("depth", "depth", ".png", frame.depth_png),
        ("lidar", "lidar", ".npy", frame.lidar_npy),
    ):
        path = folder / place / f"{frame.key}{suffix}"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, data)
        paths[name] = path.relative_to(folder).as_posix()
    return {"key": frame.key, **paths, **frame.annotation}


def _write_lines(path: Path, rows: list[dict[str, object]]) -> None:
    text = "".join(json.dumps(row, separators=(",", ":")) + "\n" for row in rows)
    write_whole(path, text.encode())


if __name__ == "__main__":
    try:
        _render_part(*sys.argv[1:])
    except BrokenPipeError:
        # Who started it has ended. Python would report this again at its own end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
