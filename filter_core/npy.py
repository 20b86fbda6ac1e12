"""Arrays in NumPy's file format, from untrusted bytes.

Parsed here because sizes must be checked before memory is taken: NumPy's own reader
allocates the size that the header states before it looks at the size of the file. It
also raises errors of Python's tokenizer. Nothing is unpickled.

References
----------
.. [1] NumPy Enhancement Proposal 1, "A simple file format for NumPy arrays".
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

NPY_MAGIC: Final = b"\x93NUMPY"

_LENGTH_BYTES: Final[Mapping[int, int]] = {1: 2, 2: 4, 3: 4}

_MAX_HEADER: Final = 16_384

_MAX_DIMENSIONS: Final = 4

_NUMBER: Final = re.compile(r"[<>|=]?(f[248]|[iu][1248]|b1)")

_TEXT: Final = re.compile(r"[<>|=]?U[1-9]\d{0,3}")

_COLUMN_NAME: Final = re.compile(r"[^\ud800-\udfff]{1,64}")
"""Text that UTF-8 can encode."""


def read_npy(
    content: bytes, *, whole: bool = False, texts: bool = False
) -> NDArray[np.generic]:
    """The array of a file of numbers, or of rows of named numbers; not copied.

    `whole`: nothing may follow the array. `texts`: values may be texts, too. ValueError
    says what is wrong with a file.
    """
    if len(content) <= 8:
        raise ValueError(f"a file of {len(content)} bytes")
    size = _LENGTH_BYTES.get(content[6])
    if not content.startswith(NPY_MAGIC) or size is None:
        raise ValueError("an unknown version of the format")
    start = 8 + size
    length = int.from_bytes(content[8:start], "little")
    if length > _MAX_HEADER:
        raise ValueError(f"a header of {length:,} bytes")
    if len(content) < start + length:
        raise ValueError("a truncated header")
    dtype, by_columns, shape = _header(content[start : start + length], texts)
    body = start + length
    needed = math.prod(shape) * dtype.itemsize
    if len(content) - body < needed or (whole and len(content) - body > needed):
        raise ValueError(f"{len(content) - body:,} bytes instead of {needed:,}")
    flat = np.frombuffer(content, dtype, math.prod(shape), body)
    return flat.reshape(shape, order="F" if by_columns else "C")


def _header(
    text: bytes, texts: bool
) -> tuple[np.dtype[np.generic], bool, tuple[int, ...]]:
    try:
        header = ast.literal_eval(text.decode("utf-8", "replace").strip())
    except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
        raise ValueError("a header that is not a dictionary") from None
    if not isinstance(header, dict):
        raise ValueError("a header that is not a dictionary")
    by_columns = header.get("fortran_order")
    if not isinstance(by_columns, bool):
        raise ValueError("no fortran_order")
    dtype = _dtype(header.get("descr"), texts)
    described = header.get("shape")
    if not isinstance(described, tuple) or len(described) > _MAX_DIMENSIONS:
        raise ValueError("no shape")
    if not all(type(side) is int and 0 <= side < 2**48 for side in described):
        raise ValueError("a shape that is not of whole numbers")
    return dtype, by_columns, described


def _dtype(described: object, texts: bool) -> np.dtype[np.generic]:
    if isinstance(described, str):
        return np.dtype(_value(described, texts))
    if not isinstance(described, list) or not described:
        raise ValueError("no descr")
    columns = []
    for column in described:
        named = isinstance(column, tuple) and len(column) == 2
        if not named or not isinstance(column[0], str):
            raise ValueError("columns without a name and a type")
        if not _COLUMN_NAME.fullmatch(column[0]):
            words = "a column whose name is not 1 to 64 characters of text"
            raise ValueError(words)
        columns.append((column[0], _value(column[1], texts)))
    if len({name for name, _ in columns}) < len(columns):
        raise ValueError("two columns of the same name")
    return np.dtype(columns)


def _value(described: object, texts: bool) -> str:
    word = described if isinstance(described, str) else ""
    if _NUMBER.fullmatch(word) or (texts and _TEXT.fullmatch(word)):
        return word
    raise ValueError(f"values of type {str(described)[:40]!r}, which is not a number")
