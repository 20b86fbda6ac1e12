"""Boxes drawn on a picture: told apart by line as well as by colour."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

# Okabe and Ito's palette, which people of any colour vision can tell apart; as B, G, R.
COLORS: Final[Mapping[str, tuple[int, int, int]]] = {
    "kept": (115, 158, 0),
    "rejected": (0, 94, 213),
    "unmeasured": (153, 153, 153),
}
_DASHES: Final[Mapping[str, tuple[int, int]]] = {
    "kept": (1, 0),
    "rejected": (9, 8),
    "unmeasured": (1, 7),
}
"""Pixels drawn and left out in turn; round ends take up to two on either side."""
_HALO: Final = (20, 20, 20)


def draw_boxes(
    canvas: NDArray[np.uint8], decisions: Sequence[Mapping[str, Any]], *, edges: bool
) -> None:
    """Draw on the picture itself: kept solid, rejected dashed, unmeasured dotted."""
    for decision in decisions:
        verdict = decision["effective_verdict"]
        lines = list(_lines(decision, edges=edges))
        for line in lines:
            _draw(canvas, line, (1, 0), _HALO, 3)
        for line in lines:
            _draw(canvas, line, _DASHES[verdict], COLORS[verdict], 2)


def _lines(
    decision: Mapping[str, Any], *, edges: bool
) -> Iterator[tuple[float, float, float, float]]:
    if edges and decision["edges"]:
        for x0, y0, x1, y1 in decision["edges"]:
            yield x0, y0, x1, y1
        return
    if decision["xyxy"] is None:
        return
    x0, y0, x1, y1 = decision["xyxy"]
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
        yield (*start, *end)


def _draw(
    canvas: NDArray[np.uint8],
    line: tuple[float, float, float, float],
    dash: tuple[int, int],
    color: tuple[int, int, int],
    width: int,
) -> None:
    start, end = np.array(line[:2]), np.array(line[2:])
    length = float(np.hypot(*(end - start)))
    on, off = dash
    if off == 0 or length == 0:
        cv2.line(canvas, _pixel(start), _pixel(end), color, width, cv2.LINE_AA)
        return
    along = (end - start) / length
    for begin in np.arange(0.0, length, on + off):
        stop = min(begin + on, length)
        cv2.line(
            canvas,
            _pixel(start + along * begin),
            _pixel(start + along * stop),
            color,
            width,
            cv2.LINE_AA,
        )


def _pixel(point: NDArray[np.float64]) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))
