"""Pictures drawn on request, by child processes, and a cache of the latest ones.

The files are untrusted: the functions that read them run in child processes only, never
in a thread of the service (`app.engine.children`). The size of a picture is limited
before it is drawn.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from app.engine.children import PixelPool
from filter_core.annotation.frame import FrameAnnotation, frame_boxes_2d
from filter_core.errors import FilterError, ImageError
from filter_core.evidence.depth import (
    DepthSlice,
    depth_interval,
    depth_slice,
    read_depth,
)
from filter_core.formats.files import write_whole
from filter_core.images import drawing
from filter_core.images.header import read_image_header
from filter_core.segmentation.palettes import FAMILIES
from filter_core.segmentation.reading import SegmentationOptions, read_segmentation
from unghost.wire.words import LayerName

MOST_PX: Final = 16_383
"""Of the longer side of a WebP."""
_TALLEST: Final = 2
"""The most rows of a thumbnail for each of its columns."""
MAX_CROP_WIDTH_PX: Final = 4096
_MAX_ENLARGEMENT: Final = 8
_HALVED: Final = 2


@dataclass(frozen=True)
class Layer:
    """The background of a picture, and the files that it is made from, as sent.

    It is the ``image`` (grey if there is none), the ``segmentation`` in its palette's
    colours, the ``blend`` of both, the ``depth`` from near (warm) to far (cold), or the
    ``instances``, each in a colour. `reading` is how the segmentation was read when it
    was measured; `measured` the depth or instance image, if that is the layer.
    """

    name: LayerName
    image: bytes | None
    segmentation: bytes | None
    reading: SegmentationOptions | None
    measured: bytes | None = None

    def picture(self) -> drawing.Picture:
        """The background, decoded and painted, which callers copy to draw on it.

        Raises ImageError: a file cannot be decoded.
        """
        if self.name == "segmentation":
            return self._painted()
        if self.name == "depth" and self.measured is not None:
            metres = read_depth(self.measured).metres(np.s_[:, :])
            share = np.log(np.clip(metres, 1.0, _FARTHEST_M)) / math.log(_FARTHEST_M)
            shades = np.rint(255 * (1 - share)).astype(np.uint8)
            return np.asarray(cv2.applyColorMap(shades, cv2.COLORMAP_TURBO), np.uint8)
        if self.measured is not None:
            # The same colour for the same object, and different ones for most others.
            pixels = drawing.decoded(self.measured).astype(np.uint32)
            packed = pixels[..., 0] | pixels[..., 1] << 8 | pixels[..., 2] << 16
            mixed = packed * np.uint32(2654435761)
            planes = [0x40 + (mixed >> shift & 0xBF) for shift in (8, 16, 24)]
            return np.stack(planes, axis=-1).astype(np.uint8)
        if self.image is None:
            image = np.full_like(self._painted(), drawing.GREY)
        else:
            image = _decoded_once(self.image)
        if self.name == "image":
            return image
        blend = cv2.addWeighted(image, 0.5, self._painted(), 0.5, 0)
        return np.asarray(blend, np.uint8)

    def _painted(self) -> drawing.Picture:
        if self.segmentation is None or self.reading is None:
            raise ImageError("the frame has no segmentation that was measured")
        read = read_segmentation(self.segmentation, self.reading)
        painted = FAMILIES[read.family].paint(read.tags)
        return np.ascontiguousarray(painted[:, :, ::-1])


@lru_cache(maxsize=2)
def _decoded_once(content: bytes) -> drawing.Picture:
    """An image of which several crops are often drawn, one after the other."""
    picture = drawing.decoded(content)
    picture.flags.writeable = False
    return picture


_FARTHEST_M: Final = 200.0
"""Depths from here on have the same colour."""


def thumbnail(image: bytes, width: int) -> bytes:
    """A WebP of an image file, at most `width` px wide and twice as high.

    It is never larger than the image. Raises ImageError: the file cannot be decoded.
    """
    # Decoding at half the size is three times faster. A single row or column of pixels
    # is decoded in full, because OpenCV would leave nothing of it.
    wh = read_image_header(image).wh
    is_whole = min(wh) < _HALVED or max(wh) < _HALVED * width
    flags = cv2.IMREAD_COLOR if is_whole else cv2.IMREAD_REDUCED_COLOR_2
    read = drawing.decoded(image, flags)
    tallest = min(width * _TALLEST, MOST_PX)
    size = _fitted(read.shape[1], read.shape[0], width, tallest, 1.0)
    return drawing.as_webp(cv2.resize(read, size, interpolation=cv2.INTER_AREA))


def crop(
    layer: Layer, xyxy: Sequence[float], pad: float, height: int, least: int = 0
) -> bytes:
    """The part of a picture around a box as WebP, at most 4096 px wide.

    `pad` is the margin on every side, as a fraction of the box's longer side; `least`
    is the least width and height of the part in px of the frame; `height` is the
    maximum height of the result in px.
    """
    picture = layer.picture()
    rows, columns = picture.shape[:2]
    wide, high = xyxy[2] - xyxy[0], xyxy[3] - xyxy[1]
    margin = pad * max(wide, high, 1.0)
    across, down = max(margin, (least - wide) / 2), max(margin, (least - high) / 2)
    x0 = int(np.clip(np.floor(xyxy[0] - across), 0, columns - 1))
    y0 = int(np.clip(np.floor(xyxy[1] - down), 0, rows - 1))
    x1 = int(np.clip(np.ceil(xyxy[2] + across), x0 + 1, columns))
    y1 = int(np.clip(np.ceil(xyxy[3] + down), y0 + 1, rows))
    part = picture[y0:y1, x0:x1]
    size = _fitted(x1 - x0, y1 - y0, MAX_CROP_WIDTH_PX, height, _MAX_ENLARGEMENT)
    shrinks = size[1] < y1 - y0 or size[0] < x1 - x0
    interpolation = cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
    return drawing.as_webp(cv2.resize(part, size, interpolation=interpolation))


def slice_of_box(
    content: bytes, annotation: FrameAnnotation, position: int, xyxy: Sequence[float]
) -> DepthSlice:
    """Where a box and its pixels are on the axis of depth.

    `position` is that of the box in the annotation; `xyxy` is its rectangle. Raises
    ImageError: the depth image cannot be read.
    """
    depth = read_depth(content)
    interval = np.full(2, np.nan)
    if annotation.camera is not None:
        vertices = frame_boxes_2d(annotation, depth.wh).vertices
        rows = slice(position, position + 1)
        interval = depth_interval(vertices[rows], annotation.camera, 0.0)[0]
    return depth_slice(depth, xyxy, interval)


def overlay(layer: Layer, boxes: Sequence[drawing.DrawnBox], edges: bool) -> bytes:
    """A picture with boxes drawn on it as WebP; without boxes, lossless PNG.

    `edges` draws the edges of 3D boxes in place of rectangles, where there are any.
    """
    picture = layer.picture()
    if not boxes:
        return drawing.as_png(picture)
    canvas = picture.copy()
    drawing.draw_boxes(canvas, boxes, edges=edges)
    return drawing.as_webp(canvas)


def _fitted(
    width: int, height: int, most_wide: int, most_high: int, enlarged: float = math.inf
) -> tuple[int, int]:
    """The largest size in px of the same aspect ratio; `enlarged` limits the factor."""
    scale = min(most_wide / width, most_high / height, enlarged)
    return (
        min(most_wide, max(1, round(width * scale))),
        min(most_high, max(1, round(height * scale))),
    )


WEBP: Final = "image/webp"
PNG: Final = "image/png"
MOST_REFUSED: Final = 1000
KEPT_BYTES: Final = 64 * 1024**2
"""Size of the cache of drawn pictures: some 4,000 crops."""
PICTURES: Final = "pictures"
"""Folder in the data folder with pictures that were drawn once. It may be deleted."""
STORED_BYTES: Final = 2 * 1024**3
_LOOKED_THROUGH: Final = "00"
"""How the tags begin of those pictures, one of 256, after which room is made."""


@dataclass(frozen=True)
class Drawing:
    """A picture to be drawn: its content is known, its files are not read yet.

    `tag` identifies it by all its inputs. `draw` reads the files and returns the
    encoded picture; it takes the event of `PixelPool.run`. A picture without verdicts,
    which change, `is_lasting`: it is kept in the data folder.
    """

    tag: str
    media_type: str
    draw: Callable[[PixelPool, threading.Event], bytes]
    is_lasting: bool = False

    def content(
        self, pool: PixelPool, cancelled: threading.Event, folder: Path
    ) -> bytes:
        """The picture, from the folder of those drawn before, or drawn and kept there.

        A folder that cannot be written to keeps nothing.
        """
        path = folder / self.tag[:2] / self.tag
        if self.is_lasting:
            with suppress(OSError):
                return path.read_bytes()
        content = self.draw(pool, cancelled)
        if self.is_lasting:
            with suppress(OSError):
                path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
                write_whole(path, content)
                if self.tag.startswith(_LOOKED_THROUGH):
                    make_room_for_pictures(folder)
        return content


def make_room_for_pictures(folder: Path, most_bytes: int = STORED_BYTES) -> None:
    """Delete the oldest of the kept pictures until they have at most so many bytes."""
    pictures = sorted(
        (state.st_mtime_ns, state.st_size, path)
        for path in folder.glob("??/*")
        for state in [path.stat()]
    )
    left = sum(size for _, size, _ in pictures)
    for _, size, path in pictures:
        if left <= most_bytes:
            return
        path.unlink(missing_ok=True)
        left -= size


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
