"""Images and point clouds for fuzzers to damage; most of them are valid."""

import io
import struct

import cv2
import numpy as np

from tests.support import frames as scene
from tests.support import pictures

WH = (scene.WIDTH, scene.HEIGHT)
TAGS = scene.tags()
RGB = pictures.painted(TAGS)
IMAGES = [
    scene.image(),
    scene.segmentation(),
    pictures.png(TAGS),
    pictures.png(pictures.with_alpha(RGB)),
    pictures.indexed_png(TAGS, np.arange(768).reshape(256, 3)),
    pictures.jpeg(RGB),
    cv2.imencode(".png", np.zeros((*TAGS.shape, 3), np.uint16))[1].tobytes(),
    cv2.imencode(".jpg", TAGS, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes(),
]
POINTS = np.zeros(
    3,
    [
        ("x", "f4"),
        ("y", "f4"),
        ("z", "f4"),
        ("CosAngle", "f4"),
        ("ObjIdx", "u4"),
        ("ObjTag", "u4"),
    ],
)


def npy(array: np.ndarray, version: tuple[int, int] = (1, 0)) -> bytes:
    out = io.BytesIO()
    np.lib.format.write_array(out, array, version)
    return out.getvalue()


def npy_of(header: str) -> bytes:
    """An NPY file with this header, followed by 64 zero bytes."""
    text = header.encode("latin-1", "replace")
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + bytes(64)


def ply(form: str, body: bytes, count: object = 3) -> bytes:
    names = ("x", "y", "z", "CosAngle", "ObjIdx", "ObjTag")
    lines = ["ply", f"format {form} 1.0", f"element vertex {count}"]
    lines += [f"property float {name}" for name in names] + ["end_header", ""]
    return "\n".join(lines).encode() + body


CLOUDS = [
    npy(POINTS),
    npy(POINTS, (2, 0)),
    npy(np.zeros((3, 6))),
    npy(np.asfortranarray(np.zeros((3, 6), np.int16))),
    ply("ascii", b"1 2 3 0.5 7 14\n" * 3),
    ply("binary_little_endian", bytes(72)),
    ply("binary_big_endian", bytes(72)),
]
