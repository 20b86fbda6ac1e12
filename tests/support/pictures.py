"""Makes small tag images from letters, and PNG and JPEG files of every kind."""

import struct
import zlib
from collections.abc import Mapping, Sequence
from functools import cache
from types import MappingProxyType

import cv2
import numpy as np
from numpy.typing import ArrayLike

from filter_core.frame_boxes import FrameBoxes
from filter_core.segmentation.palettes import FAMILIES

FAMILY = "carla-0.9.14"
LETTERS = {".": 1, "c": 14, "t": 15, "w": 12, "v": 9, "s": 11, "r": 13, "b": 16}
"""Road, Car, Truck, Pedestrian, Vegetation, Sky, Rider and Bus of `FAMILY`."""
ACCEPT = {"car": 1 << 14, "truck": 1 << 14 | 1 << 15, "walker": 1 << 12}


def tag_image(*rows: str) -> np.ndarray:
    """Tags drawn with `LETTERS`; ``?`` is Unknown."""
    tags = {**LETTERS, "?": 255}
    return np.array([[tags[letter] for letter in row] for row in rows], np.uint8)


def painted(tags: np.ndarray, family: str = FAMILY) -> np.ndarray:
    """RGB pixels in the colours that CARLA gives these tags."""
    return FAMILIES[family].paint(tags)


def tags_of(rgb: np.ndarray, family: str = FAMILY) -> np.ndarray:
    """The inverse of `painted`: 255 where a colour is none of the family's."""
    tags = np.full(rgb.shape[:2], 255, np.uint8)
    for tag in FAMILIES[family].tags:
        tags[(rgb == tag.rgb).all(axis=2)] = tag.tag
    return tags


def png(picture: np.ndarray, order: str = "rgb") -> bytes:
    """A PNG of grey, RGB or RGBA pixels; ``bgr`` writes red and blue swapped."""
    picture = np.ascontiguousarray(picture)
    if picture.ndim == 3 and order == "rgb":
        has_alpha = picture.shape[2] == 4
        swap = cv2.COLOR_RGBA2BGRA if has_alpha else cv2.COLOR_RGB2BGR
        picture = cv2.cvtColor(picture, swap)
    return cv2.imencode(".png", picture)[1].tobytes()


def pixels_of(content: bytes) -> np.ndarray:
    """The pixels of a file: grey, BGR or BGRA."""
    pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    assert pixels is not None
    return pixels


@cache
@cache
def plain_png(width: int, height: int, rgb: tuple[int, int, int] = (0, 0, 0)) -> bytes:
    """A PNG of one colour: a small file, but large when decoded."""
    row = np.full((1, width, 3), rgb[::-1], np.uint8)
    return png(np.repeat(row, height, axis=0), "bgr")


def jpeg(rgb: np.ndarray, quality: int = 95) -> bytes:
    """A JPEG of RGB pixels."""
    flags = [cv2.IMWRITE_JPEG_QUALITY, quality]
    return cv2.imencode(".jpg", np.ascontiguousarray(rgb[:, :, ::-1]), flags)[
        1
    ].tobytes()


def with_orientation(content: bytes, orientation: int) -> bytes:
    """A JPEG that EXIF says how to turn."""
    tiff = b"MM\x00*" + struct.pack(">IHHHIHHI", 8, 1, 0x0112, 3, 1, orientation, 0, 0)
    body = b"Exif\x00\x00" + tiff
    size = struct.pack(">H", len(body) + 2)
    return content[:2] + b"\xff\xe1" + size + body + content[2:]


def with_alpha(rgb: np.ndarray, alpha: np.ndarray | int = 255) -> np.ndarray:
    """RGB pixels with an alpha channel added: (H, W), or one value for all."""
    return np.dstack([rgb, np.broadcast_to(np.uint8(alpha), rgb.shape[:2])])


def chunk(kind: bytes, body: bytes = b"") -> bytes:
    """One chunk of a PNG."""
    checksum = zlib.crc32(kind + body)
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", checksum)


def png_of_chunks(header: tuple[int, ...], *chunks: bytes) -> bytes:
    """A PNG of these chunks; `header` is width, height, bit depth and colour type."""
    first = chunk(b"IHDR", struct.pack(">IIBBBBB", *header, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + first + b"".join(chunks) + chunk(b"IEND")


def indexed_png(tags: np.ndarray, colors: np.ndarray) -> bytes:
    """A PNG with a palette of its own, whose indexes are the tags."""
    height, width = tags.shape
    rows = b"".join(b"\x00" + row.tobytes() for row in tags)
    pixels = chunk(b"IDAT", zlib.compress(rows))
    palette = chunk(b"PLTE", colors.astype(np.uint8).tobytes())
    return png_of_chunks((width, height, 8, 3), palette, pixels)


def frame_boxes(
    xyxy: ArrayLike,
    wh: tuple[int, int],
    classes: str | Sequence[str] = "car",
    accept: Mapping[str, int] = MappingProxyType(ACCEPT),
) -> FrameBoxes:
    """`FrameBoxes` of rectangles; `classes` is one name for all, or one for each."""
    boxes = np.asarray(xyxy, np.float64).reshape(-1, 4)
    names = [classes] * len(boxes) if isinstance(classes, str) else list(classes)
    return FrameBoxes.of(boxes, names, accept, wh)
