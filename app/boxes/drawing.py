"""Pictures drawn on request, by child processes, and a cache of the latest ones.

The files are untrusted: the functions that read them run in child processes only, never
in a thread of the service (`app.engine.children`). The size of a picture is limited
before it is drawn.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from app.engine.children import PixelPool
from filter_core.errors import FilterError, ImageError
from filter_core.images.decoding import decode_as_seen
from filter_core.images.header import read_image_header
from filter_core.segmentation.palettes import FAMILIES
from filter_core.segmentation.reading import SegmentationOptions, read_segmentation
from unghost.wire.words import LayerName

Picture: TypeAlias = NDArray[np.uint8]
"""(H, W, 3), B, G, R."""

THUMBNAIL_WIDTH_PX: Final = 384
MAX_THUMBNAIL_HEIGHT_PX: Final = 768
MAX_CROP_WIDTH_PX: Final = 4096
_MAX_ENLARGEMENT: Final = 8
_JPEG_QUALITY: Final = 88
_GREY: Final = 96
_HALVED: Final = 2
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


class DrawnBox(NamedTuple):
    """The parts of a box that are drawn: rectangle and edges of its 3D box, in px."""

    verdict: str
    xyxy: Sequence[float] | None
    edges: Sequence[Sequence[float]] | None


@dataclass(frozen=True)
class Layer:
    """The background of a picture, and the files that it is made from.

    Attributes
    ----------
    name : ``image``, ``segmentation`` in its palette's colours, or ``blend`` of both
    image, segmentation : bytes or None
        The files as they were sent. Without an image, the background is grey.
    reading : SegmentationOptions or None
        How the segmentation was read when it was measured.
    """

    name: LayerName
    image: bytes | None
    segmentation: bytes | None
    reading: SegmentationOptions | None

    def picture(self) -> Picture:
        """The background, decoded and painted.

        Raises
        ------
        ImageError
            A file cannot be decoded, or image and segmentation differ in size.
        """
        if self.name == "segmentation":
            return self._painted()
        image = (
            np.full_like(self._painted(), _GREY)
            if self.image is None
            else _decoded(self.image)
        )
        if self.name == "image":
            return image
        mixed = cv2.addWeighted(image, 0.5, self._painted(), 0.5, 0)
        return np.asarray(mixed, np.uint8)

    def _painted(self) -> Picture:
        if self.segmentation is None or self.reading is None:
            raise ImageError("the frame has no segmentation that was measured")
        read = read_segmentation(self.segmentation, self.reading)
        painted = FAMILIES[read.family].paint(read.tags)
        return np.ascontiguousarray(painted[:, :, ::-1])


def thumbnail(image: bytes) -> bytes:
    """A small JPEG of an image file, at most 384 x 768 px.

    Raises
    ------
    ImageError
        The file cannot be decoded.
    """
    # Decoding at half the size is three times faster. A single row or column of pixels
    # is decoded in full, because OpenCV would leave nothing of it.
    is_thin = min(read_image_header(image).wh) < _HALVED
    flags = cv2.IMREAD_COLOR if is_thin else cv2.IMREAD_REDUCED_COLOR_2
    small = _decoded(image, flags)
    width, height = _fitted(
        small.shape[1], small.shape[0], THUMBNAIL_WIDTH_PX, MAX_THUMBNAIL_HEIGHT_PX
    )
    return _as_jpeg(cv2.resize(small, (width, height), interpolation=cv2.INTER_AREA))


def crop(layer: Layer, xyxy: Sequence[float], pad: float, height: int) -> bytes:
    """The part of a picture around a box as JPEG, at most 4096 px wide.

    `pad` is the margin on every side, as a fraction of the box's longer side; `height`
    is the maximum height in px.
    """
    picture = layer.picture()
    rows, columns = picture.shape[:2]
    margin = pad * max(xyxy[2] - xyxy[0], xyxy[3] - xyxy[1], 1.0)
    x0 = int(np.clip(np.floor(xyxy[0] - margin), 0, columns - 1))
    y0 = int(np.clip(np.floor(xyxy[1] - margin), 0, rows - 1))
    x1 = int(np.clip(np.ceil(xyxy[2] + margin), x0 + 1, columns))
    y1 = int(np.clip(np.ceil(xyxy[3] + margin), y0 + 1, rows))
    part = picture[y0:y1, x0:x1]
    size = _fitted(x1 - x0, y1 - y0, MAX_CROP_WIDTH_PX, height, _MAX_ENLARGEMENT)
    shrinks = size[1] < y1 - y0 or size[0] < x1 - x0
    interpolation = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
    return _as_jpeg(cv2.resize(part, size, interpolation=interpolation))


def overlay(layer: Layer, boxes: Sequence[DrawnBox], edges: bool) -> bytes:
    """A picture with boxes drawn on it as JPEG; without boxes, lossless PNG.

    `edges` draws the edges of 3D boxes in place of rectangles, where there are any.
    """
    canvas = layer.picture()
    if not boxes:
        return as_png(canvas)
    draw_boxes(canvas, boxes, edges=edges)
    return _as_jpeg(canvas)


def _fitted(
    width: int, height: int, most_wide: int, most_high: int, enlarged: float = math.inf
) -> tuple[int, int]:
    """The largest size in px of the same aspect ratio; `enlarged` limits the factor."""
    scale = min(most_wide / width, most_high / height, enlarged)
    return (
        min(most_wide, max(1, round(width * scale))),
        min(most_high, max(1, round(height * scale))),
    )


def draw_boxes(canvas: Picture, boxes: Sequence[DrawnBox], *, edges: bool) -> None:
    """Draw on the picture itself: kept solid, rejected dashed, unmeasured dotted.

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


def _decoded(image: bytes, flags: int = cv2.IMREAD_COLOR) -> Picture:
    """An image file in the frame of reference of its boxes, and opaque.

    Raises
    ------
    ImageError
        It cannot be decoded, or the decoded picture does not match its header.
    """
    picture = decode_as_seen(image, read_image_header(image), flags)
    if picture is None:
        raise ImageError("the image cannot be decoded: it is damaged")
    return picture


def _as_jpeg(picture: Picture | cv2.typing.MatLike) -> bytes:
    _, content = cv2.imencode(
        ".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    )
    return content.tobytes()


def as_png(picture: Picture) -> bytes:
    """A picture as PNG, with fast compression."""
    _, content = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return content.tobytes()


JPEG: Final = "image/jpeg"
PNG: Final = "image/png"
MOST_REFUSED: Final = 1000
KEPT_BYTES: Final = 64 * 1024**2
"""Size of the cache of drawn pictures: some 4,000 crops."""


@dataclass(frozen=True)
class Drawing:
    """A picture to be drawn: its content is known, its files are not read yet.

    Attributes
    ----------
    tag : str
        Identifies the picture by all its inputs.
    media_type : str
    draw : function of a PixelPool and the event that `PixelPool.run` takes
        Reads the files and returns the encoded picture.
    """

    tag: str
    media_type: str
    draw: Callable[[PixelPool, threading.Event], bytes]


class DrawnPictures:
    """A cache of the latest drawn pictures, by their tags; thread-safe.

    Failures are cached as well: each attempt would cost as much again.
    """

    def __init__(self, most_bytes: int = KEPT_BYTES) -> None:
        self._most_bytes = most_bytes
        self._held: OrderedDict[str, bytes] = OrderedDict()
        self._bytes = 0
        self._refused: OrderedDict[str, FilterError] = OrderedDict()
        self._changing = threading.Lock()

    def find(self, tag: str) -> bytes | None:
        """The cached picture, or None; raises the error that `refuse` cached."""
        with self._changing:
            if tag in self._refused:
                raise self._refused[tag]
            content = self._held.get(tag)
            if content is not None:
                self._held.move_to_end(tag)
            return content

    def keep(self, tag: str, content: bytes) -> None:
        """Cache a picture; the least recently used ones make room for it."""
        with self._changing:
            if len(content) > self._most_bytes // 4:
                return  # it would displace many others
            self._bytes += len(content) - len(self._held.pop(tag, b""))
            self._held[tag] = content
            while self._bytes > self._most_bytes:
                self._bytes -= len(self._held.popitem(last=False)[1])

    def refuse(self, tag: str, error: FilterError) -> None:
        """Cache the error with which drawing this picture failed."""
        with self._changing:
            self._refused[tag] = error
            while len(self._refused) > MOST_REFUSED:
                self._refused.popitem(last=False)
