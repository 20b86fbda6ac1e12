"""A street to measure: a synthetic segmentation of 1280 x 720, and boxes on it.

Sky, buildings, road, ragged vegetation, poles, vehicles and people, as a PNG of 60 to
100 KB: what a real segmentation is like.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from filter_core.classes import accept_mask_of
from filter_core.frame_boxes import FrameBoxes
from filter_core.segmentation.palettes import FAMILIES

FAMILY = "carla-0.9.14"
WIDTH, HEIGHT = 1280, 720
HORIZON = 330
IMAGE_BYTES = 1_300_000
AS_RECORDINGS = 1 / 7
"""The share of a rendered street's vehicles, people and lights that exist. It leaves
some thirty boxes within 200 m, as in the frame that the paper came with."""
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
class Street:
    """A segmentation as a PNG, and boxes with their classes."""

    png: bytes
    xyxy: np.ndarray
    classes: tuple[str, ...]

    @property
    def annotation(self) -> dict[str, Any]:
        """The boxes as a recorder would write them."""
        rows = zip(self.classes, self.xyxy.round(3).tolist(), strict=True)
        boxes = [{"class": name, "xyxy": xyxy} for name, xyxy in rows]
        return {"carla_version": "0.9.15", "boxes": boxes}


def color(name: str) -> tuple[int, int, int]:
    palette = FAMILIES[FAMILY]
    red, green, blue = palette.tags[palette.tag_of(name)].rgb
    return blue, green, red


def street(seed: int = 1, *, as_carla_writes: bool = False) -> Street:
    """A frame with about 30 boxes that cover about 150,000 pixels.

    The segmentation is as OpenCV writes it, or as CARLA's `save_to_disk` does: with
    alpha, with whichever filter suits each row, and compressed by level 6.
    """
    rng = np.random.default_rng(seed)
    image = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    image[:] = color("Sky")
    _draw_buildings(image, rng)
    _draw_ground(image)
    _draw_vegetation(image, rng)
    _draw_poles(image, rng)
    boxes, classes = _draw_objects(image, rng)
    pixels: np.ndarray = image
    options: list[int] = []
    if as_carla_writes:
        pixels = cv2.cvtColor(image, cv2.COLOR_BGR2BGRA)
        options = [cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_ALL_FILTERS]
        options += [cv2.IMWRITE_PNG_COMPRESSION, 6]
    return Street(cv2.imencode(".png", pixels, options)[1].tobytes(), boxes, classes)


def photograph() -> bytes:
    """A PNG of about the size that a camera's image has, 1.3 MB."""
    rng = np.random.default_rng(3)
    rows = np.linspace(60, 190, HEIGHT)[:, None, None]
    smooth = np.broadcast_to(rows, (HEIGHT, WIDTH, 3))
    for spread in np.linspace(0.5, 6.0, 40):
        content = _noisy(smooth, rng, spread)
        if len(content) >= IMAGE_BYTES:
            break
    return content


def soft_photograph(number: int) -> bytes:
    """Soft shapes under noise, as a PNG: as hard to decode as a rendered street."""
    rng = np.random.default_rng(number)
    small = rng.integers(40, 220, (HEIGHT // 24, WIDTH // 24, 3)).astype(np.uint8)
    smooth = cv2.resize(small, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    return _noisy(smooth, rng, 3)


def _noisy(smooth: np.ndarray, rng: np.random.Generator, spread: float) -> bytes:
    noisy = smooth + rng.normal(0, spread, smooth.shape)
    return cv2.imencode(".png", noisy.clip(0, 255).astype(np.uint8))[1].tobytes()


def crowd(seed: int, count: int) -> dict[str, Any]:
    """An annotation: from few large boxes to crowds of small ones."""
    rng = np.random.default_rng(seed)
    sides = np.exp(rng.uniform(np.log(12), np.log(280), (count, 2)))
    corners = rng.uniform(0, 1, (count, 2)) * (np.array([WIDTH, HEIGHT]) - sides)
    rows = enumerate(np.hstack([corners, corners + sides]).round(2).tolist(), 1)
    return {"boxes": [{"id": str(n), "class": "car", "xyxy": xyxy} for n, xyxy in rows]}


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
        centre = int(rng.integers(0, WIDTH)), int(rng.integers(160, HORIZON + 40))
        cv2.circle(crowns, centre, int(rng.integers(35, 85)), 1.0, -1)
        foot = centre[0] + 3, HORIZON + 60
        cv2.rectangle(image, (centre[0] - 3, centre[1]), foot, color("Vegetation"), -1)
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
    """From a few pixels to most of the image, all orders of magnitude equally often."""
    rng = np.random.default_rng(3)
    size = np.exp(rng.uniform(np.log(3), np.log(700), (count, 2)))
    centre = rng.uniform((0, 0), (WIDTH, HEIGHT), (count, 2))
    xyxy = np.hstack([centre - size / 2, centre + size / 2])
    return frame_boxes(xyxy, rng.choice(MIXED, count).tolist())
