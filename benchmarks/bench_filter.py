"""How long does it take to read and measure a frame? Ratios, measured in one run.

    python -m benchmarks.bench_filter [--json] [--repeat N] [--check]

A synthetic street stands for a real segmentation (`benchmarks/street.py`). Milliseconds
depend on the machine, ratios hardly do. `--check` exits with 1 if an aim is missed.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from benchmarks.measuring import parser_of, seconds_of, show
from benchmarks.opencv_decoding import decoding_by_opencv
from benchmarks.street import (
    CLASSES,
    HEIGHT,
    WIDTH,
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


def fastest(repeat: int, *actions: Callable[[], object]) -> list[float]:
    """Milliseconds of the fastest call of each action, which other work disturbed
    least; the actions alternate."""
    times = [[1000 * seconds_of(each) for each in actions] for _ in range(repeat)]
    return [min(of_one) for of_one in zip(*times, strict=True)]


def measured(repeat: int) -> tuple[dict[str, float], bool]:
    """The figures, and whether all aims are met."""
    frame, options = street(), SegmentationOptions(palette="auto")
    boxes = frame_boxes(frame.xyxy, frame.classes)
    segmentation = read_segmentation(frame.png, options)
    counting = Counting.of(segmentation.codes, boxes)
    image = segmentation.pixels
    colors = [list(color(CLASSES[name][1]))[::-1] for name in frame.classes]
    many, most = fixed_boxes(1000, 200, 150), any_boxes(10_000)

    def evidence(of: FrameBoxes) -> object:
        return measure(read_segmentation(frame.png, options), of)

    (loop,) = fastest(3, lambda: published_loop(image, boxes, colors))
    figures = {
        "bytes of the PNG": len(frame.png),
        "boxes": len(boxes),
        "pixels of boxes": int(measure(segmentation, boxes).box_pixels.sum()),
        "the published loop [ms]": loop,
    }
    are_met = True
    for name, aim, work in (
        ("counts", 300, lambda: counting.count(image)),
        ("evidence", 150, lambda: measure(segmentation, boxes)),
    ):
        (own,) = fastest(repeat * 3, work)
        figures[f"{name} [ms]"] = own
        figures[f"the loop / {name}: measured"] = loop / own
        figures[f"the loop / {name}: aim, at least"] = aim
        are_met &= loop / own >= aim
    for name, aim_ratio, action in (
        (
            "decode and counts",
            1.15,
            lambda: counting.count(decode(frame.png, cv2.IMREAD_COLOR_RGB)),
        ),
        ("decode and evidence", 1.25, lambda: evidence(boxes)),
        ("the same of 1,000 boxes of 200 x 150", 4.0, lambda: evidence(many)),
        ("the same of 10,000 boxes of any size", 8.0, lambda: evidence(most)),
    ):
        # Decoding runs twice and counts once, so that it does not pay for what the
        # action left in the caches.
        base = partial(decode, frame.png)
        _, alone, own = fastest(repeat, base, base, action)
        figures[f"{name} [ms]"] = own
        figures[f"{name} / decode: measured"] = own / alone
        figures[f"{name} / decode: aim, at most"] = aim_ratio
        are_met &= own / alone <= aim_ratio
    return figures, are_met


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--repeat", type=int, default=60)
    parser.add_argument("--check", action="store_true", help="fail if an aim is missed")
    options = parser.parse_args()
    png = street().png
    with decoding_by_opencv():
        figures, are_met = measured(options.repeat)
        (alone,) = fastest(options.repeat, lambda: read_segmentation(png))
    (in_use,) = fastest(options.repeat, lambda: read_segmentation(png))
    figures |= {"reading by OpenCV [ms]": alone, "reading by zlib-ng [ms]": in_use}
    show(figures, as_json=options.json)
    return int(options.check and not are_met)


if __name__ == "__main__":
    sys.exit(main())
