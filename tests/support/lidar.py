"""Makes small PLY and NPY files of semantic LiDAR points."""

import io
import struct

import numpy as np

from tests.support.sensors import CAR

POINTS = [(1.5, -2.0, 0.25, 0.5, 217, CAR), (8.0, 9.0, 1.0, 1.0, 0, 1)]
DTYPE = [
    ("x", "<f4"),
    ("y", "<f4"),
    ("z", "<f4"),
    ("CosAngle", "<f4"),
    ("ObjIdx", "<u4"),
    ("ObjTag", "<u4"),
]
TABLE = np.array(POINTS, DTYPE)


def header(form: str, count: int = len(POINTS)) -> bytes:
    names = [name for name, _ in DTYPE]
    types = ["float32"] * 4 + ["uint32"] * 2
    lines = [f"property {kind} {name}" for kind, name in zip(types, names, strict=True)]
    top = ["ply", f"format {form} 1.0", f"element vertex {count}"]
    return "\n".join([*top, *lines, "end_header\n"]).encode()


def ascii_ply() -> bytes:
    rows = (" ".join(map(str, point)) for point in POINTS)
    return header("ascii") + "\n".join(rows).encode() + b"\n"


def npy(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


def npy_of_columns(name: str) -> bytes:
    """An NPY file of two rows and two columns, the first of which is called `name`."""
    described = f"[({name!r}, '<f4'), ('a', '<f4')]"
    text = f"{{'descr': {described}, 'fortran_order': False, 'shape': (2,)}}".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + bytes(16)
