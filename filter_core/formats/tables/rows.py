"""Reads files of rows: CSV, TSV, JSON, JSON Lines, each also compressed, and NPZ.

`read_document` returns what a file holds: `Lines` of rows, which are parsed when they
are needed, or one JSON value. Numbers of CSV stay text; arrays of NPZ become lists.
"""

from __future__ import annotations

import csv
import gzip
import io
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple
from zipfile import BadZipFile, ZipFile

import numpy as np
from numpy.typing import NDArray

from filter_core.errors import JsonError, LayoutError
from filter_core.formats.reading import (
    GZIP,
    MAX_LABEL_BYTES,
    TABLE_SUFFIXES,
    is_number,
    read_label_bytes,
)
from filter_core.json_text import JsonLimits, read_json
from filter_core.npy import read_npy

MAX_BYTES: Final = 256 * 1024 * 1024
"""Of a file with the labels of many frames, after it was unpacked."""

_JSON: Final = JsonLimits(max_values=5_000_000, max_keys=5_000_000)

_MAX_ARRAYS: Final = 1000

_MAX_NUMBERS: Final = 2_000_000
"""Of arrays, which take thirty bytes each as a list."""

_DELIMITERS: Final = ("\t", ";", ",", " ")


def table_suffix(name: str) -> str:
    """The suffix of a file of rows without that of its compression; else empty."""
    plain = name.lower().removesuffix(GZIP)
    suffix = f".{plain.rpartition('.')[2]}"
    suffixes = TABLE_SUFFIXES if plain == name.lower() else TABLE_SUFFIXES[:-1]
    return suffix if suffix in suffixes else ""


class Row(NamedTuple):
    """One row.

    Attributes
    ----------
    at : str
        Its place, such as ``boxes.csv, row 7``, for errors. Rows are counted as
        spreadsheets do: the names of the columns are row 1.
    value : object
        By the names of its columns, or a list if they have none; or a value of JSON.
    problem : LayoutError or None
        Why it cannot be read.
    """

    at: str
    value: object
    problem: LayoutError | None = None


class Span(NamedTuple):
    """Rows that follow each other: their bytes, and the number of the first."""

    start: int
    end: int
    number: int


@dataclass(frozen=True)
class Lines:
    """A file of rows, each on lines of its own.

    It has the names of their columns, if any. Without a delimiter each line is JSON.
    `first` are all rows but that of the names; errors name the file by `name`.
    """

    name: str
    content: bytes = field(repr=False)
    delimiter: str | None
    columns: tuple[str, ...] | None
    first: Span

    def __iter__(self) -> Iterator[tuple[Span, Row]]:
        return self.rows([self.first])

    def rows(self, spans: Iterable[Span]) -> Iterator[tuple[Span, Row]]:
        """The rows of some spans, each with its own span."""
        for span in spans:
            yield from self._rows(span)

    def _rows(self, span: Span) -> Iterator[tuple[Span, Row]]:
        lines = _LinesOf(self.content, span.start, span.end)
        number, start = span.number, span.start
        reader = None if self.delimiter is None else _reader(lines, self.delimiter)
        while True:
            at = f"{self.name}, row {number}"
            row: Row | None
            try:
                cells = next(lines if reader is None else reader)
                row = self._row(cells, at)
            except StopIteration:
                return
            except (csv.Error, UnicodeDecodeError) as exc:
                row = Row(at, None, LayoutError(f"{at}: cannot be read: {exc}"))
            own = Span(start, lines.position, number)
            start, number = lines.position, number + 1
            if row is not None:
                yield own, row

    def _row(self, cells: Sequence[str] | str, at: str) -> Row | None:
        """A row of cells, or of JSON; None if it is empty."""
        if isinstance(cells, str):
            if not cells.strip():
                return None
            try:
                return Row(at, _json(cells, at))
            except LayoutError as exc:
                return Row(at, None, exc)
        if not any(cell.strip() for cell in cells):
            return None
        if self.columns is None:
            return Row(at, list(cells))
        row = Row(at, dict(zip(self.columns, cells, strict=False)))
        if not any(cells[len(self.columns) :]):
            return row
        expected = f"{len(self.columns)} columns"
        problem = LayoutError(f"{at}: expected {expected}, found {len(cells)}")
        return row._replace(problem=problem)


class _LinesOf:
    """The lines of a part of a text; `position` is where the last of them ends."""

    def __init__(self, content: bytes, start: int, end: int) -> None:
        self._content, self.position, self._end = content, start, end

    def __iter__(self) -> _LinesOf:
        return self

    def __next__(self) -> str:
        if self.position >= self._end:
            raise StopIteration
        start = self.position
        newline = self._content.find(b"\n", start, self._end)
        self.position = self._end if newline < 0 else newline + 1
        return self._content[start : self.position].decode()


def _reader(lines: Iterator[str], delimiter: str) -> Iterator[list[str]]:
    return csv.reader(lines, delimiter=delimiter, skipinitialspace=delimiter == " ")


def read_document(path: Path, name: str, limit: int = MAX_LABEL_BYTES) -> object:
    """What a file of rows holds: `Lines`, or one value of JSON.

    Parameters
    ----------
    path : Path
        Its suffix says its form; that of ``.txt`` is recognised by the first character.
    name : str
        For errors.
    limit : int
        Of its bytes, after it was unpacked.

    Raises
    ------
    LayoutError
        It cannot be read, is too large, or is in no such form.
    """
    content = read_label_bytes(path, name, limit)
    if path.name.lower().endswith(GZIP):
        try:
            with gzip.GzipFile(fileobj=io.BytesIO(content)) as file:
                unpacked = file.read(limit + 1)
        except (OSError, EOFError, zlib.error) as exc:
            raise LayoutError(f"{name}: expected gzip, found a fault: {exc}") from exc
        if len(unpacked) > limit:
            raise LayoutError(
                f"{name}: expected at most {limit} bytes in it, found more"
            )
        content = unpacked
    suffix = table_suffix(path.name)
    if suffix == ".npz":
        return _arrays(content, name, limit)
    content = content.removeprefix(b"\xef\xbb\xbf")
    if suffix == ".json" or (not suffix and content.lstrip()[:1] in (b"{", b"[")):
        return _json(content, name)
    if suffix == ".jsonl":
        return Lines(name, content, None, None, Span(0, len(content), 1))
    return _table(content, name, "\t" if suffix == ".tsv" else None)


def _json(content: bytes | str, at: str) -> object:
    try:
        return read_json(content, _JSON)
    except JsonError as exc:
        raise LayoutError(f"{at}: {exc.detail}", code=exc.kind) from exc


def _table(content: bytes, name: str, delimiter: str | None) -> Lines:
    """A file of delimited columns; the first row names them unless it has numbers."""
    start = len(content) - len(content.lstrip(b"\r\n"))
    lines = _LinesOf(content, start, len(content))
    try:
        head = next(lines, "")
        if delimiter is None:
            delimiter = next(
                (candidate for candidate in _DELIMITERS if candidate in head.strip()),
                ",",
            )
        lines = _LinesOf(content, start, len(content))
        cells = [cell.strip() for cell in next(_reader(lines, delimiter), [])]
    except (csv.Error, UnicodeDecodeError) as exc:
        raise LayoutError(f"{name}, row 1: cannot be read: {exc}") from exc
    if any(is_number(cell) for cell in cells):
        return Lines(name, content, delimiter, None, Span(start, len(content), 1))
    twice = next((cell for cell in cells if cell and cells.count(cell) > 1), None)
    if twice is not None:
        raise LayoutError(
            f"{name}, row 1: expected each column once, found {twice[:40]!r} again"
        )
    rows = Span(lines.position, len(content), 2)
    return Lines(name, content, delimiter, tuple(cells), rows)


def _arrays(content: bytes, name: str, limit: int) -> dict[str, object]:
    """The arrays of an NPZ file by their names, as lists."""
    arrays: dict[str, object] = {}
    left = limit
    try:
        with ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
            if len(members) > _MAX_ARRAYS:
                raise ValueError(f"more than {_MAX_ARRAYS} arrays")
            for member in members:
                with archive.open(member) as file:
                    array = file.read(left + 1)
                left -= len(array)
                if left < 0:
                    raise ValueError(f"arrays of more than {limit} bytes")
                key = member.filename.removesuffix(".npy")
                arrays[key] = _listed(read_npy(array, texts=True))
    except (
        *(BadZipFile, OSError, EOFError, ValueError, zlib.error),
        NotImplementedError,  # another compression
        RuntimeError,  # a password
    ) as exc:
        raise LayoutError(f"{name}: expected arrays of NumPy, found {exc}") from exc
    return arrays


def _listed(array: NDArray[np.generic]) -> object:
    """An array as lists; rows with names become objects."""
    if array.size * max(1, len(array.dtype.names or ())) > _MAX_NUMBERS:
        raise ValueError(f"an array of more than {_MAX_NUMBERS:,} values")
    if array.dtype.names is None or array.ndim != 1:
        return array.tolist()
    return [dict(zip(array.dtype.names, row, strict=True)) for row in array.tolist()]
