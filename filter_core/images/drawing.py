"""Draws boxes on pictures: kept solid, rejected dashed, unmeasured dotted.

Nothing is read from files here. The pictures are B, G, R, as OpenCV has them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Final, NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from filter_core.errors import ImageError
from filter_core.images.decoding import decode_as_seen
from filter_core.images.header import read_image_header

Picture: TypeAlias = NDArray[np.uint8]
"""(H, W, 3), B, G, R."""

GREY: Final = 96
"""Of a background without an image."""
_JPEG_QUALITY: Final = 88
_WEBP_QUALITY: Final = 84
_AROUND_PX: Final = 16
"""How far lines are drawn beyond the picture, so that no end shows at its border."""

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
_SOLID: Final = (1, 0)
_MOST_DASHES: Final = 100_000
_HALO: Final = (20, 20, 20)
_FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
_MOST_ROWS: Final = 9
"""Texts that are written above each other, at one place, at most."""


class DrawnBox(NamedTuple):
    """The parts of a box that are drawn: rectangle and edges of its 3D box, in px.

    `text` is written above its upper left corner, unless there is no room.
    """

    verdict: str
    xyxy: Sequence[float] | None
    edges: Sequence[Sequence[float]] | None
    text: str = ""


def draw_boxes(canvas: Picture, boxes: Sequence[DrawnBox], *, edges: bool) -> None:
    """Draw on the picture itself: kept solid, rejected dashed, unmeasured dotted.

    `edges` draws the edges of 3D boxes in place of rectangles, where there are any.
    After `_MOST_DASHES` dashes in all, which nobody could tell apart, lines are solid.
    """
    left = _MOST_DASHES
    for box in boxes:
        lines = [
            shown
            for line in _lines(box, edges=edges)
            if (shown := _within(line, canvas.shape[1], canvas.shape[0]))
        ]
        for line in lines:
            _draw(canvas, line, _SOLID, _HALO, 3)
        dash = _DASHES[box.verdict]
        left -= int(sum(map(_length, lines)) / sum(dash))
        if left < 0:
            dash = _SOLID
        for line in lines:
            _draw(canvas, line, dash, COLORS[box.verdict], 2)
    taken: list[_Place] = []
    for box in boxes:
        if box.text and box.xyxy is not None:
            write(canvas, box.text, box.xyxy[:2], COLORS[box.verdict], taken)


_Place: TypeAlias = tuple[int, int, int, int]
"""Left, top, right and bottom of a text, in px."""


def write(
    canvas: Picture,
    text: str,
    at: Sequence[float],
    color: tuple[int, int, int],
    taken: list[_Place],
) -> None:
    """Write on the picture itself, on a dark ground above a point in px.

    Where another text is, it is written higher up, and not at all if there is no place
    near; `taken` are the places of the others, to which its own is added.
    """
    height, width = canvas.shape[:2]
    scale = max(0.35, width / 2800)
    (wide, high), below = cv2.getTextSize(text, _FONT, scale, 1)
    step = high + below + 3
    left = int(np.clip(at[0], 0, max(0, width - wide - 4)))
    for row in range(_MOST_ROWS):
        top = int(np.clip(at[1], step, height)) - step * (row + 1)
        place = (left, top, left + wide + 4, top + step)
        if top < 0 and row:
            return
        if not any(
            place[0] < other[2]
            and other[0] < place[2]
            and place[1] < other[3]
            and other[1] < place[3]
            for other in taken
        ):
            break
    else:
        return
    taken.append(place)
    cv2.rectangle(canvas, place[:2], (place[2], place[3] - 1), _HALO, cv2.FILLED)
    bright = [int(255 - (255 - level) * 0.6) for level in color]
    origin = (left + 2, top + high + 1)
    cv2.putText(canvas, text, origin, _FONT, scale, bright, 1, cv2.LINE_AA)


_Line: TypeAlias = tuple[float, float, float, float]
"""x and y of the start, then of the end, in px."""


def _within(line: _Line, width: int, height: int) -> _Line | None:
    """The visible part of a line; None if there is none, or an end is not finite.

    References
    ----------
    .. [1] Liang and Barsky, "A new concept and method for line clipping", 1984.
    """
    if not np.isfinite(line).all():
        return None
    x0, y0, x1, y1 = line
    first, last = 0.0, 1.0
    for start, step, most in ((x0, x1 - x0, width), (y0, y1 - y0, height)):
        low, high = -_AROUND_PX - start, most + _AROUND_PX - start
        if step == 0:
            if low > 0 or high < 0:
                return None
            continue
        begin, end = sorted((low / step, high / step))
        first, last = max(first, begin), min(last, end)
    if first > last:
        return None
    if (first, last) == (0.0, 1.0):
        return line
    return (
        x0 + first * (x1 - x0),
        y0 + first * (y1 - y0),
        x0 + last * (x1 - x0),
        y0 + last * (y1 - y0),
    )


def _lines(box: DrawnBox, *, edges: bool) -> Iterator[_Line]:
    if edges and box.edges:
        for x0, y0, x1, y1 in box.edges:
            yield x0, y0, x1, y1
        return
    if box.xyxy is None:
        return
    x0, y0, x1, y1 = box.xyxy
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
        yield (*start, *end)


def _draw(
    canvas: Picture,
    line: _Line,
    dash: tuple[int, int],
    color: tuple[int, int, int],
    width: int,
) -> None:
    start, end = np.array(line[:2]), np.array(line[2:])
    length = _length(line)
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


def _length(line: _Line) -> float:
    return math.hypot(line[2] - line[0], line[3] - line[1])


def _pixel(point: NDArray[np.float64]) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))


def decoded(image: bytes, flags: int = cv2.IMREAD_COLOR) -> Picture:
    """An image file in the frame of reference of its boxes, and opaque.

    Raises `ImageError`: it cannot be decoded, or the decoded picture does not match its
    header.
    """
    picture = decode_as_seen(image, read_image_header(image), flags)
    if picture is None:
        raise ImageError("the image cannot be decoded: it is damaged")
    return picture


def as_jpeg(picture: Picture | cv2.typing.MatLike) -> bytes:
    """A picture as JPEG."""
    _, content = cv2.imencode(
        ".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    )
    return content.tobytes()


def as_webp(picture: Picture | cv2.typing.MatLike) -> bytes:
    """A picture as WebP, about half as large as the same one as JPEG."""
    settings = [cv2.IMWRITE_WEBP_QUALITY, _WEBP_QUALITY]
    return cv2.imencode(".webp", picture, settings)[1].tobytes()


def png_with_boxes(image: bytes, boxes: Sequence[DrawnBox]) -> bytes:
    """An image file with boxes drawn on it, as PNG: a picture of an export.

    From bytes to bytes, so that a child process can draw it.

    Raises `ImageError`: as `decoded`.
    """
    canvas = decoded(image)
    draw_boxes(canvas, boxes, edges=False)
    return as_png(canvas)


def as_png(picture: Picture) -> bytes:
    """A picture as PNG, with fast compression."""
    _, content = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return content.tobytes()
