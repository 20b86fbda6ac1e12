"""How many frames a second does `unghost.live` decide? Run on two cores.

    python -m benchmarks.bench_live [FOLDER] [--frames N] [--json] [--check]

A fake simulator ticks; its cameras show the files of FOLDER, by default of a street
that is rendered first (1280 x 720), and 40 vehicles have boxes. `--check` exits with 1
below 20 frames a second.
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import cv2
import numpy as np

import unghost
from benchmarks.measuring import parser_of
from tests.support.fake_carla.library import as_library
from tests.support.fake_carla.measurements import MEASUREMENTS, Image
from tests.support.fake_carla.simulator import Simulator, at
from unghost.street.street import StreetScene, write_street

_KINDS: Final = {
    "rgb": "rgb",
    "segmentation": "semantic_segmentation",
    "depth": "depth",
    "instances": "instance_segmentation",
}
_BOXES: Final = 40
_AIM: Final = 20.0
_RED: Final = 2


class Replayed(Image):
    """An image of a file instead of a rendered one."""

    content: memoryview

    @property
    def raw_data(self) -> memoryview:
        """The file's pixels: blue, green, red, alpha."""
        return self.content


def pixels_of(path: Path, name: str) -> np.ndarray:
    """(H, W, 4) uint8, as CARLA has an image in memory."""
    read = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert read is not None, path
    pixels = np.full((*read.shape[:2], 4), 255, np.uint8)
    if name == "segmentation" and read.ndim == 2:
        pixels[..., :3] = 0
        pixels[..., _RED] = read
    else:
        pixels[..., :3] = read[..., :3]
    return pixels


def script(folder: Path, names: tuple[str, ...]) -> tuple[Any, dict[str, Any]]:
    """A world with 40 vehicles ahead, and its cameras."""
    line = json.loads((folder / "manifest.jsonl").read_text("utf-8").splitlines()[0])
    simulator = Simulator()
    sys.modules["carla"] = carla = as_library(simulator)
    world: Any = carla.Client("127.0.0.1", 2000).get_world()
    settings = world.get_settings()
    settings.synchronous_mode = True
    world.apply_settings(settings)
    library = world.get_blueprint_library()
    car = library.find("vehicle.tesla.model3")
    ego = world.spawn_actor(car, at(0, 0))
    for number in range(_BOXES):
        world.spawn_actor(car, at(10 + 5 * (number // 4), 4 * (number % 4) - 6))
    mount = carla.Transform(carla.Location(1.5, 0, 2.4), carla.Rotation(0, 0, 0))
    sensors = {}
    for name in names:
        key = "image" if name == "rgb" else name
        pixels = pixels_of(folder / line[key], name)
        blueprint = library.find(f"sensor.camera.{_KINDS[name]}")
        blueprint.set_attribute("image_size_x", str(pixels.shape[1]))
        blueprint.set_attribute("image_size_y", str(pixels.shape[0]))
        content = {"content": memoryview(pixels.tobytes())}
        shown: Any = type("Replayed", (Replayed,), content)
        MEASUREMENTS[blueprint.id] = shown
        sensors[name] = world.spawn_actor(blueprint, mount, ego)
    return world, sensors


def rates(folder: Path, names: tuple[str, ...], frames: int) -> tuple[float, float]:
    """Frames a second, and milliseconds of the processor for each."""
    world, sensors = script(folder, names)
    with unghost.live(world, sensors=sensors) as live:
        first = next(live)
        assert len(first.decisions) == _BOXES
        wall, cpu = time.perf_counter(), time.process_time()
        for _ in range(frames):
            assert next(live).boxes is not None
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return frames / wall, 1000 * cpu / frames


def main() -> None:
    """Measure both sets of cameras, and print the rates."""
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:2])
    slowest = float("inf")
    with TemporaryDirectory() as rendered:
        folder = options.folder or Path(rendered)
        if options.folder is None:
            write_street(folder, 1, StreetScene(0), lambda *_: None)
        for names in (("rgb", "segmentation"), tuple(_KINDS)):
            rate, cpu_ms = rates(folder, names, options.frames)
            record = {"cameras": names, "frames_per_s": rate, "cpu_ms": cpu_ms}
            words = f"{', '.join(names)}: {rate:.1f} frames/s, {cpu_ms:.1f} ms of CPU"
            print(json.dumps(record) if options.json else words)
            slowest = min(slowest, rate)
    if options.check and slowest < _AIM:
        sys.exit(1)


if __name__ == "__main__":
    main()
