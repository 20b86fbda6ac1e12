"""How long does it take to read and measure a frame? Ratios, measured in one run.

    python -m benchmarks.bench_filter [--json] [--repeat N] [--check]

A synthetic street stands for a real segmentation (`benchmarks/street.py`). Milliseconds
depend on the machine, ratios hardly do. `--check` exits with 1 if an aim is missed.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

import cv2
import numpy as np

from benchmarks.opencv_decoding import decoding_by_opencv
from benchmarks.street import (
    CLASSES,
    HEIGHT,
    WIDTH,
    Street,
    any_boxes,
    color,
    fixed_boxes,
    frame_boxes,
    street,
)
from filter_core.evidence.counting import Regions, count_codes_in
from filter_core.evidence.semantic import measure
from filter_core.frame_boxes import FrameBoxes
from filter_core.geometry.boxes import pixel_bounds
from filter_core.segmentation.codes import PixelCodes
from filter_core.segmentation.reading import SegmentationOptions, read_segmentation


@dataclass(frozen=True)
class Result:
    """One line of the table: a measured ratio and its aim."""

    name: str
    milliseconds: float
    ratio: float
    aim: float
    at_least: bool

    @property
    def met(self) -> bool:
        """Whether the aim is met."""
        if self.at_least:
            return self.ratio >= self.aim
        return self.ratio <= self.aim


def published_loop(
    image: np.ndarray, boxes: FrameBoxes, colors: list[list[int]]
) -> list[int]:
    """The counting of the paper's code: every pixel of the box, as lists."""
    counts = []
    for index, (x0, y0, x1, y1) in enumerate(boxes.xyxy.clip(0).astype(int).tolist()):
        crop, expected, count = image[y0:y1, x0:x1], colors[index], 0
        for row in range(crop.shape[0]):
            for column in range(crop.shape[1]):
                if list(crop[row, column]) == list(expected):
                    count += 1
        counts.append(count)
    return counts


def decode(png: bytes, flags: int = cv2.IMREAD_UNCHANGED) -> np.ndarray:
    return np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), flags))


@dataclass(frozen=True)
class Counting:
    """Counts matched pixels from those of every tag, and measures nothing else."""

    codes: PixelCodes
    bounds: np.ndarray
    accepted: np.ndarray

    @classmethod
    def of(cls, codes: PixelCodes, boxes: FrameBoxes) -> Counting:
        tags = codes.tag_of_code[list(codes.occurring)].astype(np.int64)
        accepted = boxes.accept_mask[:, None] >> tags & 1 == 1
        return cls(codes, pixel_bounds(boxes.xyxy, (WIDTH, HEIGHT)), accepted)

    def count(self, image: np.ndarray) -> np.ndarray:
        regions = Regions(replace(self.codes, pixels=image), self.bounds)
        counts = count_codes_in(regions, self.codes.occurring)
        matched: np.ndarray = (counts * self.accepted).sum(axis=1)
        return matched


def milliseconds(action: Callable[[], object]) -> float:
    start = time.perf_counter()
    action()
    return (time.perf_counter() - start) * 1e3


def fastest(repeat: int, action: Callable[[], object]) -> float:
    """Milliseconds of the fastest of several runs, which other work disturbed least."""
    return min(milliseconds(action) for _ in range(repeat))


def against(
    repeat: int, action: Callable[[], object], base: Callable[[], object]
) -> tuple[float, float]:
    """Fastest milliseconds of an action and of the base, run alternately.

    The base runs twice and counts once, so that it does not pay for what the action
    left in the caches.
    """
    pairs = []
    for _ in range(repeat):
        base()
        pairs.append((milliseconds(base), milliseconds(action)))
    other, own = np.min(pairs, axis=0)
    return float(own), float(other)


def results(repeat: int) -> tuple[dict[str, object], list[Result]]:
    frame = street()
    with decoding_by_opencv():
        about, lines = results_by_opencv(repeat, frame)
        alone = fastest(repeat, lambda: read_segmentation(frame.png))
    in_use = fastest(repeat, lambda: read_segmentation(frame.png))
    about |= {"read_ms, by OpenCV": alone, "... by zlib-ng": in_use}
    return about, lines


def results_by_opencv(
    repeat: int, frame: Street
) -> tuple[dict[str, object], list[Result]]:
    options = SegmentationOptions(palette="auto")
    boxes = frame_boxes(frame.xyxy, frame.classes)
    segmentation = read_segmentation(frame.png, options)
    counting = Counting.of(segmentation.codes, boxes)
    image = segmentation.pixels
    colors = [list(color(CLASSES[name][1]))[::-1] for name in frame.classes]
    many, most = fixed_boxes(1000, 200, 150), any_boxes(10_000)

    def evidence(given: FrameBoxes) -> object:
        return measure(read_segmentation(frame.png, options), given)

    loop = fastest(3, lambda: published_loop(image, boxes, colors))
    counts = fastest(repeat * 3, lambda: counting.count(image))
    evidence_ms = fastest(repeat * 3, lambda: measure(segmentation, boxes))
    lines = [
        Result("counts, against the loop", counts, loop / counts, 300, True),
        Result(
            "evidence, against the loop", evidence_ms, loop / evidence_ms, 150, True
        ),
    ]
    for name, aim, action in (
        (
            "decode and counts",
            1.15,
            lambda: counting.count(decode(frame.png, cv2.IMREAD_COLOR_RGB)),
        ),
        ("decode and evidence", 1.25, lambda: evidence(boxes)),
        ("... 1,000 boxes of 200 x 150", 4.0, lambda: evidence(many)),
        ("... 10,000 boxes of any size", 8.0, lambda: evidence(most)),
    ):
        own, alone = against(repeat, action, lambda: decode(frame.png))
        lines.append(Result(name, own, own / alone, aim, False))
    about: dict[str, object] = {
        "png_bytes": len(frame.png),
        "boxes": len(boxes),
        "box_pixels": int(measure(segmentation, boxes).box_pixels.sum()),
        "decode_ms": fastest(repeat, lambda: decode(frame.png)),
        "published_loop_ms": loop,
    }
    return about, lines


def print_table(about: dict[str, object], lines: list[Result]) -> None:
    for name, value in about.items():
        print(
            f"{name:<22}{value:>12,.2f}"
            if isinstance(value, float)
            else f"{name:<22}{value:>12,}"
        )
    print(f"\n{'':<32}{'ms':>9}{'ratio':>9}   aim")
    for line in lines:
        sign = ">=" if line.at_least else "<="
        missed = "" if line.met else "   MISSED"
        print(
            f"{line.name:<32}{line.milliseconds:>9.2f}{line.ratio:>8.2f}x"
            f"   {sign} {line.aim:g}{missed}"
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print JSON instead")
    parser.add_argument("--repeat", type=int, default=60)
    parser.add_argument("--check", action="store_true", help="fail if an aim is missed")
    arguments = parser.parse_args()
    about, lines = results(arguments.repeat)
    if arguments.json:
        rows = [{**asdict(line), "met": line.met} for line in lines]
        print(json.dumps({**about, "results": rows}, indent=2))
    else:
        print_table(about, lines)
    return int(arguments.check and not all(line.met for line in lines))


if __name__ == "__main__":
    sys.exit(main())
