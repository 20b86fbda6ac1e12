"""Semantic LiDAR as evidence: files of points, and how many points are in each 3D box.

`read_points` reads PLY (text or binary) and NPY files; `check_points` only checks that
a file is as long as its header says. `points_inside` counts points in boxes.

PLY is parsed here because sizes must be checked before memory is taken. The library
plyfile (1.1.5) allocates the size that the header states before it looks at the size of
the file; and `check_points` needs a reader that makes no array.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import NOT_MEASURED, FloatArray, IntArray
from filter_core.classes import accepts
from filter_core.errors import FilterError
from filter_core.geometry.box3d import in_carla_order
from filter_core.geometry.pose import Transform
from filter_core.npy import NPY_MAGIC, read_npy

MAX_POINTS: Final = 20_000_000


class PointsError(FilterError):
    """A file is not a semantic LiDAR measurement that can be used."""

    code = "bad_lidar"


def read_points(
    content: bytes, *, max_points: int = MAX_POINTS
) -> tuple[FloatArray, IntArray]:
    """The points of a semantic LiDAR in its axes: (P, 3), metres, and (P,) tags.

    The file is recognised by its content: PLY 1.0 with a vertex element, or a NumPy
    array: structured, or of six columns x, y, z, cosine, object and tag.

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
    if content.startswith(NPY_MAGIC):
        table = _read_npy(content)
    elif content.startswith((b"ply\n", b"ply\r")):
        encoding, count, dtype, body = _ply_header(content)
        _check_count(count, max_points)
        if encoding != "ascii":
            _check_binary(content, count, dtype, body)
            binary = dtype.newbyteorder(_BYTE_ORDERS[encoding])
            table = np.frombuffer(content, binary, count, body)
        else:
            table = _ascii_points(content, body, count, dtype)
    else:
        raise _fault("a PLY or NPY file", f"{content[:8]!r}")
    if len(table) > max_points:
        raise _fault(f"at most {max_points:,} points", f"{len(table):,}")
    columns = {
        meaning: np.asarray(table[name], np.float64)
        for meaning, name in _columns_by_meaning(table.dtype.names or ()).items()
    }
    xyz = np.stack([columns["x"], columns["y"], columns["z"]], axis=1)
    if not all(np.isfinite(column).all() for column in columns.values()):
        raise _fault("finite numbers", "NaN or an infinity")
    numbers = [columns[name] for name in ("object", "tag") if name in columns]
    if max(np.abs(column).max(initial=0) for column in numbers) > _MAX_EXACT:
        raise _fault(f"objects and tags up to {_MAX_EXACT:,}", "larger ones")
    return xyz, columns["tag"].astype(np.int64)


def check_points(content: bytes, *, sensor: str, max_points: int = MAX_POINTS) -> str:
    """Check that a file of points is as long as its own header says.

    Returns its media type: ``application/x-ply`` or ``application/x-npy``.

    Parameters
    ----------
    content : bytes
        Of a semantic LiDAR, as `read_points` takes it; or of a radar, whose columns may
        have any names.
    sensor : ``lidar`` or ``radar``
        Whose columns are expected, and what errors name.

    Raises
    ------
    PointsError
        As `read_points`, but words of text are only counted, and need not be numbers.

    Notes
    -----
    No array of the points is made. Counting the words of text takes half a millisecond
    per MiB.
    """
    try:
        if content.startswith(NPY_MAGIC):
            array = _npy_array(content, whole=True)
            if sensor == "lidar":
                _has_named_columns(array)
            if array.ndim == 0 or len(array) > max_points:
                raise _fault(
                    f"rows, at most {max_points:,}", f"an array of {array.shape}"
                )
            return "application/x-npy"
        if content.startswith((b"ply\n", b"ply\r")):
            _check_ply(content, sensor, max_points)
            return "application/x-ply"
        raise _fault("a PLY or NPY file", f"{content[:8]!r}")
    except PointsError as error:
        text = error.detail.replace("the LiDAR file", f"the {sensor} file", 1)
        raise PointsError(text, pointer=f"/{sensor}") from None


def _fault(expected: str, found: str) -> PointsError:
    return PointsError(
        f"the LiDAR file: expected {expected}, found {found}", pointer="/lidar"
    )


_SPELLINGS: Final[Mapping[str, tuple[str, ...]]] = {
    "x": ("x",),
    "y": ("y",),
    "z": ("z",),
    "object": ("objidx", "object_idx", "object_id", "object"),
    "tag": ("objtag", "object_tag", "tag", "label"),
}


def _columns_by_meaning(names: Sequence[str]) -> dict[str, str]:
    """The file's own names of the columns that are needed; PointsError without."""
    lower = {name.lower(): name for name in names}
    columns: dict[str, str] = {}
    for meaning, spellings in _SPELLINGS.items():
        name = next(
            (lower[spelling] for spelling in spellings if spelling in lower), None
        )
        if name is not None:
            columns[meaning] = name
        elif meaning != "object":
            raise _fault(f"a column {spellings[0]}", ", ".join(lower)[:200] or "none")
    return columns


_MAX_EXACT: Final = 2**53
"""Up to here, float64 holds every whole number exactly."""


_UNNAMED_COLUMNS: Final = ("x", "y", "z", "cos", "object", "tag")


def _read_npy(content: bytes) -> NDArray[np.void]:
    array = _npy_array(content)
    if _has_named_columns(array):
        return np.asarray(array)
    table = np.empty(len(array), [(name, "f8") for name in _UNNAMED_COLUMNS])
    for column, name in enumerate(_UNNAMED_COLUMNS):
        table[name] = array[:, column]
    return table


def _has_named_columns(array: NDArray[np.generic]) -> bool:
    """Whether its columns have names; `PointsError` if they are not a LiDAR's."""
    if array.dtype.names is not None and array.ndim == 1:
        _columns_by_meaning(array.dtype.names)
        return True
    if array.ndim != 2 or array.shape[1] != 6 or array.dtype.kind not in "fiu":
        shape = f"shape {array.shape} of {array.dtype}"
        raise _fault("an array of 6 columns (x, y, z, cosine, object, tag)", shape)
    return False


def _npy_array(content: bytes, *, whole: bool = False) -> NDArray[np.generic]:
    try:
        return read_npy(content, whole=whole)
    except ValueError as error:
        raise _fault("a complete NumPy array of numbers", str(error)) from None


_PLY_TYPES: Final[Mapping[str, str]] = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip

_BYTE_ORDERS: Final[Mapping[str, Literal["<", ">"]]] = {
    "binary_little_endian": "<",
    "binary_big_endian": ">",
}

_MAX_PLY_HEADER: Final = 16_384

_TEXT_CHUNK: Final = 1 << 20
"""Bytes of text split at a time: as a list, words take 30 times their size."""

_BLANKS: Final = (b"\n", b" ", b"\r", b"\t", b"\x0b", b"\x0c")

_MAX_DIGITS: Final = 18


def _check_ply(content: bytes, sensor: str, max_points: int) -> None:
    encoding, count, dtype, body = _ply_header(content)
    _check_count(count, max_points)
    if sensor == "lidar":
        _columns_by_meaning(dtype.names or ())
    if encoding != "ascii":
        _check_binary(content, count, dtype, body)
        return
    needed, word_count = count * len(dtype.names or ()), _words_in(content, body)
    if word_count < needed:
        raise _too_few_words(word_count, count, dtype)


def _check_count(count: int, max_points: int) -> None:
    if count > max_points:
        raise _fault(f"at most {max_points:,} points", f"{count:,}")


def _check_binary(
    content: bytes, count: int, dtype: np.dtype[np.void], body: int
) -> None:
    needed = count * dtype.itemsize
    if len(content) - body < needed:
        size = f"{len(content) - body:,} bytes: it is truncated"
        raise _fault(f"{needed:,} bytes of points", size)


def _ascii_points(
    content: bytes, body: int, count: int, dtype: np.dtype[np.void]
) -> NDArray[np.void]:
    names = dtype.names or ()
    needed = count * len(names)
    # A number takes at least a digit and a blank: allocate no more than can be there.
    if needed > len(content) - body:
        raise _too_few_words(_words_in(content, body), count, dtype)
    numbers = np.empty(needed)
    word_count, at = 0, body
    while word_count < needed and at < len(content):
        # The offset after the last blank within a chunk
        end = min(at + _TEXT_CHUNK, len(content))
        if end < len(content):
            end = max(content.rfind(blank, at, end) for blank in _BLANKS) + 1
            if end == 0:
                raise _fault("numbers", f"a word of more than {_TEXT_CHUNK:,} bytes")
        words = content[at:end].split(None, needed - word_count)[: needed - word_count]
        try:
            numbers[word_count : word_count + len(words)] = np.array(words, np.float64)
        except ValueError:
            raise _fault("numbers", "text among the points") from None
        word_count, at = word_count + len(words), end
    if word_count < needed:
        raise _too_few_words(word_count, count, dtype)
    rows = numbers.reshape(count, len(names))
    table = np.empty(count, [(name, "f8") for name in names])
    for column, name in enumerate(names):
        table[name] = rows[:, column]
    return table


def _words_in(content: bytes, start: int) -> int:
    """How many words there are from `start` on, counted a chunk at a time."""
    words, before = 0, True
    for at in range(start, len(content), _TEXT_CHUNK):
        part = np.frombuffer(content, np.uint8, min(_TEXT_CHUNK, len(content) - at), at)
        # Words are separated by blanks and by the bytes from tab to carriage return.
        is_blank = (part == 0x20) | (part - np.uint8(9) < 5)
        words += int(before and not is_blank[0])
        words += int(np.count_nonzero(is_blank[:-1] & ~is_blank[1:]))
        before = bool(is_blank[-1])
    return words


def _too_few_words(
    word_count: int, count: int, dtype: np.dtype[np.void]
) -> PointsError:
    return _fault(
        f"{count:,} points of {len(dtype.names or ())} numbers",
        f"{word_count:,} numbers: it is truncated",
    )


def _ply_header(content: bytes) -> tuple[str, int, np.dtype[np.void], int]:
    """Encoding, number of vertices, their type, and where they begin."""
    end = content.find(b"end_header", 0, _MAX_PLY_HEADER)
    body = content.find(b"\n", end) + 1
    if end < 0 or body == 0:
        raise _fault("a PLY header with end_header", "none")
    lines = content[:end].decode("ascii", "replace").splitlines()[1:]
    encoding, count, columns = _ply_elements([line.split() for line in lines])
    if encoding not in ("ascii", *_BYTE_ORDERS):
        raise _fault("format ascii or binary", f"{encoding[:40]!r}")
    if count < 0 or not columns:
        raise _fault("an element vertex with properties", "none")
    try:
        return encoding, count, np.dtype(columns), body
    except ValueError:
        raise _fault("properties of different names", "a name twice") from None


def _ply_elements(lines: list[list[str]]) -> tuple[str, int, list[tuple[str, str]]]:
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
            if len(words) != 3 or words[1] not in _PLY_TYPES:
                raise _fault("properties of a number type", " ".join(words)[:60])
            columns.append((words[2], _PLY_TYPES[words[1]]))
    return encoding, count, columns


def _vertex_count(words: list[str], before: str, count: int) -> int:
    if words[1] != "vertex":
        if count < 0:
            raise _fault("the element vertex first", f"{words[1][:40]!r}")
        return count
    if before or not words[2].isdecimal() or len(words[2]) > _MAX_DIGITS:
        raise _fault("one element vertex with a number", " ".join(words)[:60])
    return int(words[2])


_FLATTEST: Final = 1e-9


def points_inside(
    xyz: FloatArray,
    tags: IntArray,
    sensor: Transform,
    vertices: FloatArray,
    accept_mask: IntArray,
) -> IntArray:
    """(N,) int64: how many points of an accepted tag lie inside each box.

    `NOT_MEASURED` for boxes that are not 3D.

    Parameters
    ----------
    xyz, tags : (P, 3) float64, metres, and (P,) int64
        As `read_points` gives them.
    sensor : Transform
        The LiDAR's pose in the world, which is rarely the camera's.
    vertices : (N, 8, 3) float64, metres; NaN rows for boxes that are not 3D
    accept_mask : (N,) int64

    Notes
    -----
    Exact for every parallelepiped. Points are sorted by x first, so that each box is
    compared with a slice of them only.
    """
    counts = np.full(len(vertices), NOT_MEASURED, np.int64)
    matrix = sensor.matrix
    world = xyz @ matrix[:3, :3].T + matrix[:3, 3]
    order = np.argsort(world[:, 0], kind="stable")
    world = world[order]
    tags = np.maximum(tags, 0)[order]
    solid = np.flatnonzero(~np.isnan(vertices).any(axis=(1, 2)))
    corners = in_carla_order(vertices[solid])
    for row, box in zip(solid.tolist(), corners, strict=True):
        begin, end = np.searchsorted(world[:, 0], [box[:, 0].min(), box[:, 0].max()])
        near = slice(int(begin), int(end) + 1)
        accepted = accepts(int(accept_mask[row]), tags[near])
        axes = np.stack([box[4] - box[0], box[2] - box[0], box[1] - box[0]], axis=1)
        counts[row] = 0
        if abs(np.linalg.det(axes)) >= _FLATTEST:
            # Inside, each coordinate along the box's own axes is within 0..1.
            local = np.linalg.solve(axes, (world[near][accepted] - box[0]).T)
            inside = ((local >= 0) & (local <= 1)).all(axis=0)
            counts[row] = np.count_nonzero(inside)
    return counts
