"""Rows as a Parquet file, a group at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from typing import Any, Final

from filter_core.formats.decisions import COLUMNS
from filter_core.formats.spool import Spool

_ROWS_PER_GROUP: Final = 20_000

_TYPES: Final = {str: "string", float: "float64", int: "int64", bool: "bool_"}


def fill_parquet(
    pyarrow: Any,  # noqa: ANN401  # a module without types
    rows: Iterable[Mapping[str, Any]],
    spool: Spool,
) -> None:
    """Write rows into a spool; the same rows give the same bytes.

    Memory holds one group of rows, whatever their number.
    """
    schema = pyarrow.schema(
        [(name, getattr(pyarrow, _TYPES[kind])()) for name, kind in COLUMNS.items()]
    )
    target = pyarrow.PythonFile(spool.file, mode="w")
    with pyarrow.parquet.ParquetWriter(target, schema, compression="zstd") as writer:
        for group in _groups(rows):
            writer.write_table(pyarrow.Table.from_pylist(group, schema=schema))


def _groups(rows: Iterable[Mapping[str, Any]]) -> Iterator[list[dict[str, Any]]]:
    left = iter(rows)
    while group := [_plain(row) for row in islice(left, _ROWS_PER_GROUP)]:
        yield group


def _plain(row: Mapping[str, Any]) -> dict[str, Any]:
    """Text that Unicode has a form for: a lone surrogate from JSON has none."""
    return {
        name: value.encode("utf-8", "replace").decode() if type(value) is str else value
        for name, value in row.items()
    }
