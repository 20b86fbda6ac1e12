"""How close does filtering a folder come to only decoding and measuring its pixels?

    python -m benchmarks.bench_local [--frames 400] [--rounds 5] [--workers N]
        [--json] [--check]

A manifest of frames like CARLA's (a 1.3 MB image, the street's segmentation, 30 boxes)
is filtered as `unghost filter` does, from its lines to decisions on the disk. For
comparison, one thread per core only decodes and measures the same segmentations, which
are in memory already: by OpenCV, and as the product does. They alternate within one
run, and ratios are of the medians.
"""

from __future__ import annotations

import json
import os
import statistics
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from benchmarks.measuring import parser_of, seconds_of, show
from benchmarks.opencv_decoding import decoding_by_opencv
from benchmarks.street import HEIGHT, WIDTH, Street, frame_boxes, photograph, street
from filter_core.evidence.semantic import measure
from filter_core.segmentation.reading import SegmentationOptions, read_segmentation
from unghost.cli.local.filter import FilterOptions, filter_local

SCENES = 8
AIM_RATE_RATIO = 0.85


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--frames", type=int, default=400)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--workers", type=int, help="else the filter chooses")
    parser.add_argument(
        "--check", action="store_true", help="fail if the aim is missed"
    )
    options = parser.parse_args()
    scenes = [street(seed) for seed in range(SCENES)]
    cores = os.cpu_count() or 1
    with tempfile.TemporaryDirectory() as folder:
        source = write_frames(Path(folder), scenes, options.frames)
        output = Path(folder) / "decisions.jsonl"
        command = FilterOptions(source=source, output=output, workers=options.workers)
        with_opencv, pixels, all_of_it = alternating(
            options.rounds,
            lambda: by_opencv(scenes, options.frames, cores),
            lambda: only_pixels(scenes, options.frames, cores),
            lambda: filter_local(command),
        )
    ratio = with_opencv / all_of_it
    figures = {
        "frames": options.frames,
        "threads that only decode and measure": cores,
        "decode and measure by OpenCV [frames/s]": options.frames / with_opencv,
        "decode and measure [frames/s]": options.frames / pixels,
        "unghost filter [frames/s]": options.frames / all_of_it,
        "rate, against zlib-ng's: measured": pixels / all_of_it,
        "rate, against OpenCV's decoder: measured": ratio,
        "rate, against OpenCV's decoder: aim, at least": AIM_RATE_RATIO,
    }
    show(figures, as_json=options.json)
    return int(options.check and ratio < AIM_RATE_RATIO)


def write_frames(folder: Path, scenes: list[Street], count: int) -> Path:
    """A manifest; every frame has its own lines and shares its scene's files."""
    image = photograph()
    for index, scene in enumerate(scenes):
        (folder / f"seg{index}.png").write_bytes(scene.png)
        (folder / f"rgb{index}.png").write_bytes(image)
    manifest = folder / "manifest.jsonl"
    with manifest.open("w") as lines:
        for number in range(count):
            frame = annotation(scenes[number % SCENES], number)
            files = {
                "image": f"rgb{number % SCENES}.png",
                "segmentation": f"seg{number % SCENES}.png",
            }
            lines.write(json.dumps({**frame, **files}) + "\n")
    return manifest


def annotation(scene: Street, number: int) -> dict[str, object]:
    """What CARLA's recorder would write of a frame."""
    boxes = [
        {"id": str(index), "distance": 10.0 + index, **box}
        for index, box in enumerate(scene.annotation["boxes"])
    ]
    camera = {"width": WIDTH, "height": HEIGHT, "fov": 90}
    return {**scene.annotation, "key": f"{number:06}", "camera": camera, "boxes": boxes}


def only_pixels(scenes: list[Street], frames: int, workers: int) -> None:
    """Decode and measure, and nothing else."""
    reading = SegmentationOptions(carla_version="0.9.15")
    boxes = [frame_boxes(scene.xyxy, scene.classes) for scene in scenes]

    def measure_one(number: int) -> None:
        index = number % SCENES
        measure(read_segmentation(scenes[index].png, reading), boxes[index])

    with ThreadPoolExecutor(workers) as pool:
        for _ in pool.map(measure_one, range(frames)):
            pass


def by_opencv(scenes: list[Street], frames: int, workers: int) -> None:
    """The same without zlib-ng."""
    with decoding_by_opencv():
        only_pixels(scenes, frames, workers)


def alternating(rounds: int, *actions: Callable[[], object]) -> list[float]:
    """Median seconds of each, run alternately; the first round is not counted."""
    taken = [[seconds_of(action) for action in actions] for _ in range(rounds + 1)][1:]
    return [statistics.median(of_one) for of_one in zip(*taken, strict=True)]


if __name__ == "__main__":
    sys.exit(main())
