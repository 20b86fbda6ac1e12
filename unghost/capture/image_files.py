"""Cameras' images as PNG, without losing a bit of what they mean."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from unghost.capture.errors import CaptureError
from unghost.capture.simulator import Measurement

_RED = 2
"""In memory a pixel is blue, green, red, alpha."""


def png(name: str, image: Measurement) -> bytes:
    """The image of the camera `name` as a PNG file.

    The segmentation's tags are its red channel alone, written as one grey channel; the
    others are written in true RGB order: depth and instance ids are three bytes.
    """
    pixels = _pixels(image)
    plane = pixels[..., _RED] if name == "segmentation" else pixels[..., :3]
    done, encoded = cv2.imencode(".png", np.ascontiguousarray(plane))
    if not done:
        raise CaptureError(f"{name}: the image could not be written as PNG")
    return encoded.tobytes()


def _pixels(image: Measurement) -> NDArray[np.uint8]:
    # A view of memory that lives as long as the image: encoded before it dies.
    flat = np.frombuffer(image.raw_data, np.uint8)
    return flat.reshape(int(image.height), int(image.width), 4)
