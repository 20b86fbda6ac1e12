"""Slow reference implementations, with which tests compare the fast ones."""

import math

import numpy as np


def slow_edges(box, profile: str = "paper") -> list[float]:
    """A box whose edges that were rounded are whole numbers again."""
    if profile != "paper":
        return list(box)
    (x0, x1), (y0, y1) = _whole(*box[::2]), _whole(*box[1::2])
    return [x0, y0, x1, y1]


def _whole(low: float, high: float) -> tuple[float, float]:
    edges = [
        float(round(edge)) if abs(edge - round(edge)) <= 0.01 + 1e-9 else edge
        for edge in (low, high)
    ]
    is_lost = edges[0] == edges[1] and low != high
    return (low, high) if is_lost else (edges[0], edges[1])


def slow_counts(
    tags: np.ndarray, box: np.ndarray, mask: int, ignore: np.ndarray | None = None
) -> tuple[int, int, list[int]]:
    """Count the pixels, matched pixels and tags of one box in profile `paper`."""
    height, width = tags.shape
    histogram = [0] * 31
    x0, y0, x1, y1 = slow_edges([float(value) for value in box])
    x0, x1 = min(max(x0, 0.0), width), min(max(x1, 0.0), width)
    y0, y1 = min(max(y0, 0.0), height), min(max(y1, 0.0), height)
    if x1 <= x0 or y1 <= y0:
        return 0, 0, histogram
    matched = 0
    for row in range(math.floor(y0), math.ceil(y1)):
        for column in range(math.floor(x0), math.ceil(x1)):
            if ignore is not None and ignore[row, column]:
                continue
            tag = int(tags[row, column])
            histogram[min(tag, 30)] += 1
            matched += tag < 30 and mask >> tag & 1
    return sum(histogram), matched, histogram


def slow_crowding(xyxy: np.ndarray, masks: np.ndarray) -> list[float]:
    """How many percent of each box one other box with a common tag covers at most."""
    return [
        max(
            (
                _covered_percent(box, other)
                for place, other in enumerate(xyxy)
                if place != index and masks[index] & masks[place]
            ),
            default=0.0,
        )
        for index, box in enumerate(xyxy)
    ]


def _covered_percent(box: np.ndarray, other: np.ndarray) -> float:
    if np.isnan(box).any() or np.isnan(other).any():
        return 0.0
    width = max(0.0, min(box[2], other[2]) - max(box[0], other[0]))
    height = max(0.0, min(box[3], other[3]) - max(box[1], other[1]))
    share = (width * height) / ((box[2] - box[0]) * (box[3] - box[1]))
    return float(100.0 * share)
