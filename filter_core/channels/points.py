"""Files of CARLA's semantic LiDAR: .ply (text or binary) and .npy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from filter_core.channels.npy_file import MAGIC, read_npy
from filter_core.errors import FilterError
from filter_core.types import FloatArray, IntArray

_PLY_TYPES: Final[Mapping[str, str]] = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_FORMATS: Final[Mapping[str, Literal["<", ">"]]] = {
    "binary_little_endian": "<",
    "binary_big_endian": ">",
}
_HEADER_LIMIT: Final = 16_384
_MOST_DIGITS: Final = 18
_MOST: Final = 2**53
"""Whole numbers up to here are the same as floats."""
MAX_POINTS: Final = 20_000_000
_NAMES: Final[Mapping[str, tuple[str, ...]]] = {
    "x": ("x",),
    "y": ("y",),
    "z": ("z",),
    "object": ("objidx", "object_idx", "object_id", "object"),
    "tag": ("objtag", "object_tag", "tag", "label"),
}
_COLUMNS: Final = ("x", "y", "z", "cos", "object", "tag")


class PointsError(FilterError):
    """A file is not a semantic LiDAR measurement that can be used."""

    code = "bad_lidar"


@dataclass(frozen=True, eq=False)
class LidarPoints:
    """Points of a semantic LiDAR, in the sensor's axes.

    Attributes
    ----------
    xyz : (P, 3) float64, metres
    object_id : (P,) int64
    tag : (P,) int64
    """

    xyz: FloatArray
    object_id: IntArray
    tag: IntArray

    def __len__(self) -> int:
        return len(self.tag)


def read_points(content: bytes, *, max_points: int = MAX_POINTS) -> LidarPoints:
    """Read a semantic LiDAR file, recognised by its content.

    Parameters
    ----------
    content : bytes
        PLY 1.0 with a vertex element, or a NumPy array: structured, or of six columns
        x, y, z, cosine, object and tag.
    max_points : int

    Raises
    ------
    PointsError
        Neither of the two, truncated, without x, y, z and tag, or with too many points.

    References
    ----------
    .. [1] CARLA documentation, ``carla.SemanticLidarDetection``.
    .. [2] G. Turk, "The PLY polygon file format", 1994.
    .. [3] NumPy Enhancement Proposal 1, "A simple file format for NumPy arrays".
    """
    if content.startswith(MAGIC):
        table = _read_npy(content)
    elif content.startswith((b"ply\n", b"ply\r")):
        table = _read_ply(content, max_points)
    else:
        raise _fault("a PLY or NPY file", f"{content[:8]!r}")
    if len(table) > max_points:
        raise _fault(f"at most {max_points:,} points", f"{len(table):,}")
    return _named(table)


def _fault(expected: str, found: str) -> PointsError:
    return PointsError(
        f"the LiDAR file: expected {expected}, found {found}", pointer="/lidar"
    )


def _read_npy(content: bytes) -> NDArray[np.void]:
    try:
        array = read_npy(content)
    except ValueError as error:
        raise _fault("a whole NumPy array of numbers", str(error)) from None
    if array.dtype.names is not None and array.ndim == 1:
        return np.asarray(array)
    if array.ndim != 2 or array.shape[1] != 6 or array.dtype.kind not in "fiu":
        found = f"shape {array.shape} of {array.dtype}"
        raise _fault("an array of 6 columns (x, y, z, cosine, object, tag)", found)
    table = np.empty(len(array), [(name, "f8") for name in _COLUMNS])
    for column, name in enumerate(_COLUMNS):
        table[name] = array[:, column]
    return table


def _read_ply(content: bytes, max_points: int) -> NDArray[np.void]:
    encoding, count, dtype, body = _ply_header(content)
    if count > max_points:
        raise _fault(f"at most {max_points:,} points", f"{count:,}")
    if encoding != "ascii":
        order = _FORMATS[encoding]
        binary = dtype.newbyteorder(order)
        needed = count * binary.itemsize
        if len(content) - body < needed:
            found = f"{len(content) - body:,} bytes: it is truncated"
            raise _fault(f"{needed:,} bytes of points", found)
        return np.frombuffer(content, binary, count, body)
    return _ascii_points(content[body:], count, dtype)


def _ascii_points(
    text: bytes, count: int, dtype: np.dtype[np.void]
) -> NDArray[np.void]:
    names = dtype.names or ()
    try:
        words = text.split(None, count * len(names))[: count * len(names)]
        numbers = np.array(words, dtype=np.float64)
    except ValueError:
        raise _fault("numbers", "words among the points") from None
    if len(numbers) < count * len(names):
        found = f"{len(numbers):,} numbers: it is truncated"
        raise _fault(f"{count:,} points of {len(names)} numbers", found)
    rows = numbers.reshape(count, len(names))
    table = np.empty(count, [(name, "f8") for name in names])
    for column, name in enumerate(names):
        table[name] = rows[:, column]
    return table


def _ply_header(content: bytes) -> tuple[str, int, np.dtype[np.void], int]:
    """Encoding, number of vertices, their type, and where they begin."""
    end = content.find(b"end_header", 0, _HEADER_LIMIT)
    body = content.find(b"\n", end) + 1
    if end < 0 or body == 0:
        raise _fault("a PLY header that ends", "none")
    lines = content[:end].decode("ascii", "replace").splitlines()[1:]
    encoding, count, columns = _ply_elements([line.split() for line in lines])
    if encoding not in ("ascii", *_FORMATS):
        raise _fault("format ascii or binary", f"{encoding[:40]!r}")
    if count < 0 or not columns:
        raise _fault("an element vertex with properties", "none")
    try:
        return encoding, count, np.dtype(columns), body
    except ValueError:
        raise _fault("properties of different names", "one name twice") from None


def _ply_elements(
    lines: list[list[str]],
) -> tuple[str, int, list[tuple[str, str]]]:
    encoding, element, count = "", "", -1
    columns: list[tuple[str, str]] = []
    for words in lines:
        keyword = words[0] if words else ""
        if keyword == "format" and len(words) >= 2:
            encoding = words[1]
        elif keyword == "element" and len(words) == 3:
            count = _vertex_count(words, element, count)
            element = words[1]
        elif keyword == "property" and element == "vertex":
            columns.append(_ply_property(words))
    return encoding, count, columns


def _vertex_count(words: list[str], before: str, count: int) -> int:
    if words[1] != "vertex":
        if count < 0:
            raise _fault("the element vertex first", f"{words[1][:40]!r}")
        return count
    if before or not words[2].isdecimal() or len(words[2]) > _MOST_DIGITS:
        raise _fault("one element vertex with a number", " ".join(words)[:60])
    return int(words[2])


def _ply_property(words: list[str]) -> tuple[str, str]:
    if len(words) != 3 or words[1] not in _PLY_TYPES:
        raise _fault("properties of a number type", " ".join(words)[:60])
    return words[2], _PLY_TYPES[words[1]]


def _named(table: NDArray[np.void]) -> LidarPoints:
    lower = {name.lower(): name for name in table.dtype.names or ()}
    found: dict[str, NDArray[np.float64]] = {}
    for wanted, spellings in _NAMES.items():
        name = next((lower[one] for one in spellings if one in lower), None)
        if name is not None:
            found[wanted] = np.asarray(table[name], np.float64)
        elif wanted != "object":
            raise _fault(f"a column {spellings[0]}", ", ".join(lower) or "none")
    xyz = np.stack([found["x"], found["y"], found["z"]], axis=1)
    if not all(np.isfinite(column).all() for column in found.values()):
        raise _fault("finite numbers", "NaN or an infinity")
    objects = found.get("object", np.zeros(len(xyz)))
    if max(np.abs(objects).max(initial=0), np.abs(found["tag"]).max(initial=0)) > _MOST:
        raise _fault(f"objects and tags up to {_MOST:,}", "larger ones")
    return LidarPoints(xyz, objects.astype(np.int64), found["tag"].astype(np.int64))
