"""CARLA's encodings of a frame's planes, as PNG files."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from app.demo.paint import FAMILY
from app.demo.textures import Float32
from filter_core.segmentation.palettes import palette_of
from filter_core.types import TagImage

_DEPTH_STEPS: Final = (1 << 24) - 1
_DEPTH_RANGE: Final = 1000.0


def paint_tags(tags: TagImage) -> NDArray[np.uint8]:
    """(H, W, 3): tags in CARLA's palette colours."""
    return palette_of(FAMILY).paint(tags)


def raw_tags(tags: TagImage) -> NDArray[np.uint8]:
    """(H, W, 3): tags in the red channel, as the sensor delivers them."""
    raw = np.zeros((*tags.shape, 3), dtype=np.uint8)
    raw[..., 0] = tags
    return raw


def encode_instances(tags: TagImage, instances: NDArray[np.int32]) -> NDArray[np.uint8]:
    """(H, W, 3): red is the tag, the number is green + 256 blue."""
    return np.stack([tags, instances & 255, instances >> 8], axis=-1).astype(np.uint8)


def decode_instances(rgb: NDArray[np.uint8]) -> tuple[TagImage, NDArray[np.int32]]:
    """Tags and numbers of an instance image."""
    wide = rgb.astype(np.int32)
    return rgb[..., 0], wide[..., 1] + 256 * wide[..., 2]


def encode_depth(depth: Float32) -> NDArray[np.uint8]:
    """(H, W, 3): metres = 1000 (R + 256 G + 65536 B) / (2^24 - 1)."""
    share = np.clip(depth.astype(np.float64) / _DEPTH_RANGE, 0, 1)
    steps = np.rint(share * _DEPTH_STEPS).astype(np.int32)
    return np.stack([steps & 255, (steps >> 8) & 255, steps >> 16], axis=-1).astype(
        np.uint8
    )


def decode_depth(rgb: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Metres of a depth image."""
    wide = rgb.astype(np.float64)
    steps = wide[..., 0] + 256 * wide[..., 1] + 65536 * wide[..., 2]
    return steps * (_DEPTH_RANGE / _DEPTH_STEPS)


def png(rgb: NDArray[np.uint8], compression: int = 4) -> bytes:
    """An RGB image as a PNG file."""
    settings = [cv2.IMWRITE_PNG_COMPRESSION, compression]
    done, data = cv2.imencode(".png", np.ascontiguousarray(rgb[..., ::-1]), settings)
    if not done:
        raise RuntimeError("OpenCV could not encode a PNG")
    return data.tobytes()
