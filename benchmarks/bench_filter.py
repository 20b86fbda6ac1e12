"""How fast the filter's pixel work is, as ratios measured in one run.

    python -m benchmarks.bench_filter [--json] [--repeat N] [--check]

A synthetic 1280 x 720 street stands for a real segmentation: sky, buildings, road,
ragged vegetation, poles, vehicles and people, as a PNG of 60 to 100 KB. Milliseconds
depend on the machine, ratios hardly do. `--check` exits with 1 if a promise is broken.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace

import cv2
import numpy as np

from benchmarks.yardstick import decoder_in_use, decoding_by_opencv
from filter_core.boxes import pixel_bounds
from filter_core.classes import accept_mask_of
from filter_core.counting import Regions, count_matches
from filter_core.measure import FrameBoxes, measure
from filter_core.palettes import FAMILIES
from filter_core.pixel_codes import PixelCodes
from filter_core.segmentation import SegmentationOptions, read_segmentation

FAMILY = "carla-0.9.14"
WIDTH, HEIGHT = 1280, 720
HORIZON = 330
CLASSES = {
    "car": (14, "Car", 210, 150),
    "truck": (3, "Truck", 260, 260),
    "bus": (1, "Bus", 300, 280),
    "walker": (7, "Pedestrian", 60, 170),
    "motorcycle": (2, "Motorcycle", 80, 120),
    "bicycle": (3, "Bicycle", 80, 120),
}
MIXED = ("car", "truck", "van", "bus", "motorcycle", "bicycle", "walker")


@dataclass(frozen=True)
class Result:
    """One line of the table: a measured ratio and the promise it is held to."""

    name: str
    milliseconds: float
    ratio: float
    promise: float
    at_least: bool

    @property
    def kept(self) -> bool:
        """Whether the promise holds."""
        if self.at_least:
            return self.ratio >= self.promise
        return self.ratio <= self.promise


@dataclass(frozen=True)
class Street:
    """A segmentation as a PNG, and boxes with their classes."""

    png: bytes
    xyxy: np.ndarray
    classes: tuple[str, ...]


# --- the street ---------------------------------------------------------------------


def color(name: str) -> tuple[int, int, int]:
    palette = FAMILIES[FAMILY]
    red, green, blue = palette.tags[palette.tag_of(name)].rgb
    return blue, green, red


def street(seed: int = 1) -> Street:
    """A frame with about 30 boxes that cover about 150,000 pixels."""
    rng = np.random.default_rng(seed)
    image = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    image[:] = color("Sky")
    _draw_buildings(image, rng)
    _draw_ground(image)
    _draw_vegetation(image, rng)
    _draw_poles(image, rng)
    boxes, classes = _draw_objects(image, rng)
    png = cv2.imencode(".png", image)[1].tobytes()
    return Street(png, boxes, classes)


def _draw_buildings(image: np.ndarray, rng: np.random.Generator) -> None:
    left = 0
    while left < WIDTH:
        wide, top = int(rng.integers(60, 180)), int(rng.integers(40, 250))
        shape = [(left, 370), (left, top), (left + wide, top - 9), (left + wide, 370)]
        cv2.fillPoly(image, [np.array(shape)], color("Building"))
        left += wide + int(rng.integers(0, 40))


def _draw_ground(image: np.ndarray) -> None:
    middle = WIDTH // 2
    cv2.rectangle(image, (0, 350), (WIDTH, HEIGHT), color("Terrain"), -1)
    for name, near, far in (("Sidewalk", 1340, 90), ("Road", 940, 60)):
        shape = [(middle - far, HORIZON), (middle + far, HORIZON)]
        shape += [(middle + near, HEIGHT), (middle - near, HEIGHT)]
        cv2.fillPoly(image, [np.array(shape)], color(name))
    for step in range(12):
        top, bottom = (
            HORIZON + int(390 * a**1.5) for a in (step / 12, step / 12 + 0.04)
        )
        half = 2 + step // 2
        corners = (middle - half, top), (middle + half, bottom)
        cv2.rectangle(image, *corners, color("RoadLine"), -1)


def _draw_vegetation(image: np.ndarray, rng: np.random.Generator) -> None:
    """Crowns with leaves: ragged edges and holes are what costs a PNG its bytes."""
    leaves = rng.random((HEIGHT, WIDTH), np.float32)
    twigs = rng.random((HEIGHT // 4, WIDTH // 4), np.float32)
    texture = cv2.resize(twigs, (WIDTH, HEIGHT)) * 0.75 + leaves * 0.25
    crowns = np.zeros((HEIGHT, WIDTH), np.float32)
    for _ in range(18):
        center = int(rng.integers(0, WIDTH)), int(rng.integers(160, HORIZON + 40))
        cv2.circle(crowns, center, int(rng.integers(35, 85)), 1.0, -1)
        foot = center[0] + 3, HORIZON + 60
        cv2.rectangle(image, (center[0] - 3, center[1]), foot, color("Vegetation"), -1)
    density = cv2.GaussianBlur(crowns, (0, 0), 14)
    image[density * 0.75 + texture * 0.93 > 0.82] = color("Vegetation")


def _draw_poles(image: np.ndarray, rng: np.random.Generator) -> None:
    for index in range(12):
        left, top = int(rng.integers(0, WIDTH)), int(rng.integers(120, 260))
        wide = int(rng.integers(2, 7))
        corners = (left, top), (left + wide, HORIZON + 90)
        cv2.rectangle(image, *corners, color("Pole"), -1)
        sign = color("TrafficLight" if index % 2 else "TrafficSign")
        cv2.rectangle(image, (left - 6, top), (left + 8, top + 30), sign, -1)


def _draw_objects(
    image: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, tuple[str, ...]]:
    boxes, classes = [], []
    for name, (count, tag, wide, high) in CLASSES.items():
        for _ in range(count):
            scale = 0.12 + 0.72 * rng.random() ** 1.6
            x = float(rng.uniform(40, WIDTH - 40))
            y = HORIZON + 15 + scale * 270
            half, top = wide * scale / 2, y - high * scale
            box = [x - half, top, x + half, y]
            _draw_object(image, box, tag)
            boxes.append(box)
            classes.append(name)
    return np.array(boxes), tuple(classes)


def _draw_object(image: np.ndarray, box: list[float], tag: str) -> None:
    x0, y0, x1, y1 = box
    outline = [(0, 0.8), (0, 0.45), (0.2, 0.05), (0.75, 0), (0.98, 0.4), (1, 0.8)]
    outline += [(0.9, 1), (0.1, 1)]
    shape = [(x0 + u * (x1 - x0), y0 + v * (y1 - y0)) for u, v in outline]
    cv2.fillPoly(image, [np.round(shape).astype(np.int32)], color(tag))
    if tag in ("Motorcycle", "Bicycle"):
        head = round((x0 + x1) / 2), round(y0 + (y1 - y0) / 5)
        cv2.circle(image, head, max(1, round((x1 - x0) / 5)), color("Rider"), -1)


def frame_boxes(xyxy: np.ndarray, classes: Sequence[str]) -> FrameBoxes:
    masks = {name: accept_mask_of(name, FAMILY) for name in set(classes)}
    return FrameBoxes.of(xyxy, classes, masks, (WIDTH, HEIGHT))


def fixed_boxes(count: int, wide: int, high: int) -> FrameBoxes:
    rng = np.random.default_rng(2)
    corner = rng.uniform((0, 0), (WIDTH - wide, HEIGHT - high), (count, 2))
    xyxy = np.hstack([corner, corner + np.array([wide, high])])
    return frame_boxes(xyxy, rng.choice(MIXED, count).tolist())


def any_boxes(count: int) -> FrameBoxes:
    """From a few pixels to most of the image, every order of magnitude alike."""
    rng = np.random.default_rng(3)
    size = np.exp(rng.uniform(np.log(3), np.log(700), (count, 2)))
    center = rng.uniform((0, 0), (WIDTH, HEIGHT), (count, 2))
    xyxy = np.hstack([center - size / 2, center + size / 2])
    return frame_boxes(xyxy, rng.choice(MIXED, count).tolist())


# --- what is measured ---------------------------------------------------------------


def published_loop(
    image: np.ndarray, boxes: FrameBoxes, colors: list[list[int]]
) -> list[int]:
    """The counting of the paper's code: every pixel of the box, as lists."""
    counts = []
    for index, (x0, y0, x1, y1) in enumerate(boxes.xyxy.clip(0).astype(int).tolist()):
        crop, wanted, count = image[y0:y1, x0:x1], colors[index], 0
        for row in range(crop.shape[0]):
            for column in range(crop.shape[1]):
                if list(crop[row, column]) == list(wanted):
                    count += 1
        counts.append(count)
    return counts


def decode(png: bytes, flags: int = cv2.IMREAD_UNCHANGED) -> np.ndarray:
    return np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), flags))


@dataclass(frozen=True)
class Counting:
    """Matched pixels alone, for a palette that is known: nothing else is looked at."""

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
        return count_matches(regions, self.codes.occurring, self.accepted)


def milliseconds(action: Callable[[], object]) -> float:
    start = time.perf_counter()
    action()
    return (time.perf_counter() - start) * 1e3


def fastest(repeat: int, action: Callable[[], object]) -> float:
    """Milliseconds of the quickest of several: what others on the machine cost is not
    the action's."""
    return min(milliseconds(action) for _ in range(repeat))


def against(
    repeat: int, action: Callable[[], object], base: Callable[[], object]
) -> tuple[float, float]:
    """Fastest milliseconds of an action and of what it is compared with, in turns.

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
    about |= {"read_ms, by OpenCV": alone, f"... by {decoder_in_use()}": in_use}
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
    whole = fastest(repeat * 3, lambda: measure(segmentation, boxes))
    lines = [
        Result("counts, against the loop", counts, loop / counts, 600, True),
        Result("evidence, against the loop", whole, loop / whole, 150, True),
    ]
    for name, promise, action in (
        (
            "decode and counts",
            1.08,
            lambda: counting.count(decode(frame.png, cv2.IMREAD_COLOR_RGB)),
        ),
        ("decode and evidence", 1.25, lambda: evidence(boxes)),
        ("... 1,000 boxes of 200 x 150", 4.0, lambda: evidence(many)),
        ("... 10,000 boxes of any size", 8.0, lambda: evidence(most)),
    ):
        own, alone = against(repeat, action, lambda: decode(frame.png))
        lines.append(Result(name, own, own / alone, promise, False))
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
    print(f"\n{'':<32}{'ms':>9}{'ratio':>9}   promised")
    for line in lines:
        sign = ">=" if line.at_least else "<="
        kept = "" if line.kept else "   BROKEN"
        print(
            f"{line.name:<32}{line.milliseconds:>9.2f}{line.ratio:>8.2f}x"
            f"   {sign} {line.promise:g}{kept}"
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print JSON instead")
    parser.add_argument("--repeat", type=int, default=60)
    parser.add_argument("--check", action="store_true", help="fail if one is broken")
    arguments = parser.parse_args()
    about, lines = results(arguments.repeat)
    if arguments.json:
        rows = [{**asdict(line), "kept": line.kept} for line in lines]
        print(json.dumps({**about, "results": rows}, indent=2))
    else:
        print_table(about, lines)
    return int(arguments.check and not all(line.kept for line in lines))


if __name__ == "__main__":
    sys.exit(main())
