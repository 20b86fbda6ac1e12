"""The arrays of the library, and dataclasses whose fields are columns of them.

Row i of a column is box i.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import Field, fields, replace
from typing import ClassVar, Final, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

TagImage: TypeAlias = NDArray[np.uint8]
"""(H, W): CARLA's semantic tag of each pixel; 255 is Unknown."""


Mask: TypeAlias = NDArray[np.bool_]
"""(H, W): always boolean, never a tag image."""


BoxesXYXY: TypeAlias = NDArray[np.float64]
"""(N, 4) px, ``x_min y_min x_max y_max``, half-open: ``[0, 0, 1, 1]`` is one pixel."""


FloatArray: TypeAlias = NDArray[np.float64]


IntArray: TypeAlias = NDArray[np.int64]


BoolArray: TypeAlias = NDArray[np.bool_]


UNKNOWN_TAG: Final = 255
"""The tag of a pixel whose colour or number is no tag of its family."""


NOT_MEASURED: Final = -1
"""Stands for a missing value in columns of counts, rows and ids."""


class Dataclass(Protocol):
    """Any dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Field[object]]]


_Table = TypeVar("_Table", bound=Dataclass)


def rows_of(
    table: _Table, rows: slice | IntArray | BoolArray, *, shared: Collection[str] = ()
) -> _Table:
    """Some rows of a table, that is, of a dataclass whose fields are columns.

    `rows` are a slice, (M,) int64 or bool; a slice gives views of the same arrays.
    Columns that are None stay None. The `shared` fields are no columns, and stay as
    they are.
    """
    columns = {
        spec.name: getattr(table, spec.name)
        for spec in fields(table)
        if spec.name not in shared
    }
    return replace(
        table,
        **{
            name: column[rows] for name, column in columns.items() if column is not None
        },
    )


def floats_or_none(column: FloatArray) -> list[float | None]:
    """The numbers of a column, None where it has NaN."""
    # NaN alone differs from itself.
    return [None if value != value else value for value in column.tolist()]


def counts_or_none(column: IntArray) -> list[int | None]:
    """The numbers of a column, None where it has `NOT_MEASURED`."""
    return [None if value == NOT_MEASURED else value for value in column.tolist()]
