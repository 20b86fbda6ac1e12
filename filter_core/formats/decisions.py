"""Every decision of every frame, whatever its verdict: as JSONL, CSV or Parquet.

JSONL has whole decisions, a line for each frame; the tables have a row for each box and
a column for each plain value.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import islice
from types import ModuleType
from typing import Final

from filter_core.annotation.frame import FORMS_3D
from filter_core.errors import NotAvailable
from filter_core.formats.export import (
    ExportFrame,
    ExportHead,
    ExportOptions,
    Sink,
)
from filter_core.formats.files import Spool, json_bytes
from filter_core.formats.format import Format
from filter_core.formats.tally import Counts, ExportTally

DECISIONS_JSONL: Final = Format(
    name="decisions-jsonl",
    title="Decisions, JSON lines",
    holds="`decisions.jsonl`: every decision of every frame, one frame per line",
    needs=frozenset({"decisions", "explanations", "annotation"}),
)

DECISIONS_CSV: Final = Format(
    name="decisions-csv",
    title="Decisions, CSV",
    holds="`decisions.csv`: one row per box, for spreadsheets",
    needs=frozenset({"decisions"}),
)

DECISIONS_PARQUET: Final = Format(
    name="decisions-parquet",
    title="Decisions, Parquet",
    holds=(
        "`decisions.parquet`: the same, for data frames; needs `pip install "
        "'unghost[parquet]'`"
    ),
    needs=frozenset({"decisions"}),
)


@DECISIONS_JSONL.writer
def _write_jsonl(
    frames: Iterable[ExportFrame], sink: Sink, head: ExportHead, options: ExportOptions
) -> Counts:
    return _write(frames, sink, head, _jsonl)


@DECISIONS_CSV.writer
def _write_csv(
    frames: Iterable[ExportFrame], sink: Sink, head: ExportHead, options: ExportOptions
) -> Counts:
    return _write(frames, sink, head, _csv)


@DECISIONS_PARQUET.writer
def _write_parquet(
    frames: Iterable[ExportFrame], sink: Sink, head: ExportHead, options: ExportOptions
) -> Counts:
    return _write(frames, sink, head, _parquet)


def _write(
    frames: Iterable[ExportFrame],
    sink: Sink,
    head: ExportHead,
    pieces: Callable[[Iterator[ExportFrame], Spool], Iterable[bytes]],
) -> Counts:
    """Write every decision of every frame, and ``manifest.json``.

    Parameters
    ----------
    frames : iterable of ExportFrame
        Read once, one at a time.
    sink : callable
        Gets ``decisions.SUFFIX``, then ``manifest.json``.
    head : ExportHead
    pieces : callable
        Gives the content of the file, and may use a spool for it.

    Returns
    -------
    dict
        The counts, as ``manifest.json`` has them.

    Raises
    ------
    ExportError
        As `ExportTally.counts`.
    NotAvailable
        Parquet, without the library that writes it.
    """
    with ExportTally(head) as tally, Spool(head.temporary) as spool:
        name = head.format.replace("-", ".")  # decisions.jsonl and so on
        sink(name, pieces(_counted(frames, tally), spool))
        sink("manifest.json", tally.manifest())
        return tally.counts()


def _counted(
    frames: Iterable[ExportFrame], tally: ExportTally
) -> Iterator[ExportFrame]:
    for frame in frames:
        tally.frame(frame)
        tally.written(tally.came(frame))
        yield frame


def _jsonl(frames: Iterator[ExportFrame], _spool: Spool) -> Iterator[bytes]:
    """A line for each frame; 3D boxes come out as they came in."""
    for frame in frames:
        decisions = [
            {**decision, **{form: box[form] for form in FORMS_3D if form in box}}
            for decision, box in zip(frame.decisions, frame.given.boxes, strict=True)
        ]
        line = {"key": frame.key, "palette": frame.palette, "decisions": decisions}
        yield json_bytes(line) + b"\n"


_ROWS_AT_ONCE: Final = 500


def _csv(frames: Iterator[ExportFrame], _spool: Spool) -> Iterator[bytes]:
    """RFC 4180 with a header, some hundred rows at a time."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\r\n")
    writer.writerow(COLUMNS)
    for number, row in enumerate(_rows(frames), start=1):
        writer.writerow([_cell(row[name]) for name in COLUMNS])
        if number % _ROWS_AT_ONCE == 0:
            yield _drained(text)
    yield _drained(text)


_CORNERS: Final = ("x_min", "y_min", "x_max", "y_max")

COLUMNS: Final[Mapping[str, type]] = {
    "frame": str,
    "map": str,
    "box": str,
    "class": str,
    "verdict": str,
    "effective_verdict": str,
    "reason": str,
    "match_percent": float,
    "threshold": float,
    "margin": float,
    "toss_up": bool,
    "large": bool,
    "matched_pixels": int,
    "box_pixels": int,
    "area_percent": float,
    "crowding": float,
    "explained_by": str,
    "hidden_by": str,
    "lossy": bool,
    "distance": float,
    **dict.fromkeys(_CORNERS, float),
    "review": str,
    "reviewer": str,
    "comment": str,
    "config": str,
}
"""Every column and what it holds; any value may be missing."""


def _rows(frames: Iterable[ExportFrame]) -> Iterator[dict[str, object]]:
    """Every box of every frame under the names of `COLUMNS`."""
    for frame in frames:
        for decision in frame.decisions:
            yield _row(frame, decision)


def _row(frame: ExportFrame, decision: Mapping[str, object]) -> dict[str, object]:
    found, hiding, xyxy = map(decision.get, ("review", "hidden_by", "xyxy"))
    review = found if isinstance(found, dict) else {}
    tags = hiding if isinstance(hiding, list) else []
    corners = xyxy if isinstance(xyxy, list) else [None] * len(_CORNERS)
    return {
        **{name: decision.get(name) for name in COLUMNS},
        **dict(zip(_CORNERS, corners, strict=True)),
        "frame": frame.key,
        "map": frame.map,
        "box": decision["id"],
        "effective_verdict": decision.get("effective_verdict") or decision["verdict"],
        "hidden_by": "; ".join(f"{tag['name']} {tag['percent']:.1f}" for tag in tags),
        "review": review.get("verdict"),
        "reviewer": review.get("reviewer"),
        "comment": review.get("comment"),
    }


_FORMULA: Final = ("=", "+", "-", "@", "\t", "\r", "\n")


def _cell(value: object) -> object:
    """A value as CSV has it; text that looks like a formula gets an apostrophe."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str) and value.startswith(_FORMULA):
        return f"'{value}"
    return "" if value is None else value


def _drained(text: io.StringIO) -> bytes:
    """The text so far, which is empty then."""
    content = text.getvalue()
    text.seek(0)
    text.truncate()
    return content.encode("utf-8", "backslashreplace")


@DECISIONS_PARQUET.requirement
def require_parquet() -> ModuleType:
    """The library that writes Parquet.

    Raises
    ------
    NotAvailable
        It is not installed; the message says how to get it.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise NotAvailable(
            "Parquet needs pyarrow, which is not installed: pip install "
            "'unghost[parquet]'"
        ) from error
    library: ModuleType = pyarrow
    return library


_ROWS_PER_GROUP: Final = 20_000

_TYPES: Final = {str: "string", float: "float64", int: "int64", bool: "bool_"}


def _parquet(frames: Iterator[ExportFrame], spool: Spool) -> Iterator[bytes]:
    """A group of rows at a time, into a file first: Parquet's index comes last."""
    pyarrow = require_parquet()
    schema = pyarrow.schema(
        [(name, getattr(pyarrow, _TYPES[kind])()) for name, kind in COLUMNS.items()]
    )
    target = pyarrow.PythonFile(spool.file, mode="w")
    with pyarrow.parquet.ParquetWriter(target, schema, compression="zstd") as writer:
        for group in _groups(_rows(frames)):
            writer.write_table(pyarrow.Table.from_pylist(group, schema=schema))
    yield from spool.pieces()


def _groups(rows: Iterable[Mapping[str, object]]) -> Iterator[list[dict[str, object]]]:
    left = iter(rows)
    while group := [_plain(row) for row in islice(left, _ROWS_PER_GROUP)]:
        yield group


def _plain(row: Mapping[str, object]) -> dict[str, object]:
    """The row, with text that can be encoded: half a surrogate pair becomes ``?``."""
    return {
        name: value.encode("utf-8", "replace").decode() if type(value) is str else value
        for name, value in row.items()
    }
