"""Writes small folders of files and images for tests that read them."""

from __future__ import annotations

import cv2
import numpy as np

from filter_core.segmentation.palettes import FAMILIES


def write_files(root, files):
    """Write files, by path below `root`, of text or bytes; None makes a small PNG."""
    for name, content in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if content is None:
            content = png(np.zeros((60, 80, 3), np.uint8))
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return root


def png(pixels):
    """PNG bytes of an RGB or grey image."""
    swapped = pixels[..., ::-1] if pixels.ndim == 3 else pixels
    return cv2.imencode(".png", np.ascontiguousarray(swapped))[1].tobytes()


def painted(tags, family="carla-0.9.14"):
    """PNG bytes of a tag image, painted in a palette family's colours."""
    return png(FAMILIES[family].paint(tags))


def street_tags(car_xyxy=(10, 10, 50, 40), wh=(80, 60)):
    """A tag image: sky above, road below, and one car."""
    tags = np.full((wh[1], wh[0]), 11, np.uint8)
    tags[wh[1] // 2 :] = 1
    x_min, y_min, x_max, y_max = car_xyxy
    tags[y_min:y_max, x_min:x_max] = 14
    return tags


def annotation_of(frame):
    """The annotation of a frame that was read without a problem."""
    assert frame.annotation is not None, frame.problem
    return frame.annotation
