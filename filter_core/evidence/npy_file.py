"""NumPy's file format, as far as tables of numbers need it; nothing is unpickled.

Read by ourselves: NumPy's reader allocates what a header promises before it looks how
much there is, and lets errors of Python's tokenizer through.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

MAGIC: Final = b"\x93NUMPY"

_LENGTH_BYTES: Final[Mapping[int, int]] = {1: 2, 2: 4, 3: 4}

_LONGEST_HEADER: Final = 16_384

_MOST_SIDES: Final = 4

_NUMBER: Final = re.compile(r"[<>|=]?(f[248]|[iu][1248]|b1)")

_NAME: Final = re.compile(r"[^\ud800-\udfff]{1,64}")
"""Text that UTF-8 has a form for."""


def read_npy(content: bytes, *, whole: bool = False) -> NDArray[np.generic]:
    """The array of a file of numbers, or of rows of named numbers; not copied.

    Parameters
    ----------
    content : bytes
    whole : bool
        True: nothing may follow the array.

    Raises
    ------
    ValueError
        Not such a file, or one that ends before its array does; the text says how.

    References
    ----------
    .. [1] NumPy Enhancement Proposal 1, "A simple file format for NumPy arrays".
    """
    size = _LENGTH_BYTES.get(content[6]) if len(content) > 8 else None
    if not content.startswith(MAGIC) or size is None:
        raise ValueError("a beginning that is none of versions 1 to 3")
    start = 8 + size
    length = int.from_bytes(content[8:start], "little")
    if length > _LONGEST_HEADER:
        raise ValueError(f"a header of {length:,} bytes")
    dtype, by_columns, shape = _header(content[start : start + length])
    body = start + length
    needed = math.prod(shape) * dtype.itemsize
    if len(content) - body < needed or (whole and len(content) - body > needed):
        raise ValueError(f"{len(content) - body:,} bytes instead of {needed:,}")
    flat = np.frombuffer(content, dtype, math.prod(shape), body)
    return flat.reshape(shape, order="F" if by_columns else "C")


def _header(text: bytes) -> tuple[np.dtype[np.generic], bool, tuple[int, ...]]:
    try:
        header = ast.literal_eval(text.decode("utf-8", "replace").strip())
    except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
        raise ValueError("a header that is no dictionary") from None
    if not isinstance(header, dict):
        raise ValueError("a header that is no dictionary")
    by_columns = header.get("fortran_order")
    if not isinstance(by_columns, bool):
        raise ValueError("no order of its numbers")
    return _dtype(header.get("descr")), by_columns, _shape(header.get("shape"))


def _dtype(described: object) -> np.dtype[np.generic]:
    if isinstance(described, str):
        return np.dtype(_number(described))
    if not isinstance(described, list) or not described:
        raise ValueError("no type of its numbers")
    columns = []
    for column in described:
        named = isinstance(column, tuple) and len(column) == 2
        if not named or not isinstance(column[0], str):
            raise ValueError("columns that are not names with a type")
        if not _NAME.fullmatch(column[0]):
            words = "columns that are not named with 1 to 64 characters of text"
            raise ValueError(words)
        columns.append((column[0], _number(column[1])))
    if len({name for name, _ in columns}) < len(columns):
        raise ValueError("two columns of one name")
    return np.dtype(columns)


def _number(described: object) -> str:
    if not isinstance(described, str) or not _NUMBER.fullmatch(described):
        raise ValueError(f"values of type {str(described)[:40]!r}, which is no number")
    return described


def _shape(described: object) -> tuple[int, ...]:
    if not isinstance(described, tuple) or len(described) > _MOST_SIDES:
        raise ValueError("no shape")
    if not all(type(side) is int and 0 <= side < 2**48 for side in described):
        raise ValueError("no shape of whole numbers")
    return described
