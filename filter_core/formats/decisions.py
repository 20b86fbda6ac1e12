"""Every decision of every frame, whatever its verdict: as JSONL, CSV or Parquet.

JSONL has whole decisions, a line for each frame; the tables have a row for each box and
a column for each plain value.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import islice
from typing import Any, Final, TypeAlias

from filter_core.errors import NotAvailable
from filter_core.formats.export import (
    ExportBox,
    ExportFrame,
    ExportHead,
    ExportOptions,
    Sink,
)
from filter_core.formats.files import Spool, json_bytes
from filter_core.formats.format import Format, Write
from filter_core.formats.tally import Counts, ExportTally

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

_FORMULA: Final = ("=", "+", "-", "@", "\t", "\r", "\n")

_ROWS_AT_ONCE: Final = 500


def row_of(frame: ExportFrame, box: ExportBox) -> dict[str, Any]:
    """One box under the names of `COLUMNS`."""
    decision = box.decision
    review = decision.get("review")
    review = review if isinstance(review, Mapping) else {}
    hidden_by = decision.get("hidden_by")
    hiding = hidden_by if isinstance(hidden_by, (list, tuple)) else ()
    row: dict[str, Any] = {name: decision.get(name) for name in COLUMNS}
    corners = box.rectangle("xyxy") or (None,) * 4
    return {
        **row,
        **dict(zip(_CORNERS, corners, strict=True)),
        "frame": frame.key,
        "map": frame.map,
        "box": box.id,
        "effective_verdict": box.verdict,
        "hidden_by": "; ".join(f"{tag['name']} {tag['percent']:.1f}" for tag in hiding),
        "review": review.get("verdict"),
        "reviewer": review.get("reviewer"),
        "comment": review.get("comment"),
    }


def csv_pieces(rows: Iterable[Mapping[str, Any]]) -> Iterator[bytes]:
    """RFC 4180 with a header, some hundred rows at a time."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\r\n")
    writer.writerow(COLUMNS)
    for number, row in enumerate(rows, start=1):
        writer.writerow([_cell(row[name]) for name in COLUMNS])
        if number % _ROWS_AT_ONCE == 0:
            yield _taken(text)
    yield _taken(text)


def _taken(text: io.StringIO) -> bytes:
    content = text.getvalue()
    text.seek(0)
    text.truncate()
    return content.encode("utf-8", "backslashreplace")


def _cell(value: object) -> object:
    """A value as a spreadsheet can be given it: text from users is no formula."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str) and value.startswith(_FORMULA):
        return f"'{value}"
    return "" if value is None else value


Pieces: TypeAlias = Callable[[Iterator[ExportFrame], Spool], Iterable[bytes]]


def write_decisions(
    frames: Iterable[ExportFrame], sink: Sink, head: ExportHead, form: str = "jsonl"
) -> Counts:
    """Every decision of every frame, and the books of the export.

    Parameters
    ----------
    frames : iterable of ExportFrame
        Read once, one at a time.
    sink : callable
        Gets ``decisions.FORM``, then ``manifest.json``.
    head : ExportHead
    form : {"jsonl", "csv", "parquet"}

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
    pieces = _FORMS[form]
    with ExportTally(head) as tally, Spool(head.temporary) as spool:
        sink(f"decisions.{form}", pieces(_counted(frames, tally), spool))
        sink("manifest.json", tally.manifest(f"decisions-{form}"))
        return tally.counts()


def require_parquet() -> Any:  # noqa: ANN401  # a module without types
    """The library that writes Parquet; `NotAvailable` says how to get it."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise NotAvailable(
            "Parquet needs pyarrow, which is not installed: pip install "
            "'unghost[parquet]'"
        ) from error
    return pyarrow


def _counted(
    frames: Iterable[ExportFrame], tally: ExportTally
) -> Iterator[ExportFrame]:
    for frame in frames:
        tally.frame(frame)
        for box in frame.boxes:
            tally.box(box)
            tally.written(frame, box, clipped=False)
        yield frame


def _jsonl(frames: Iterator[ExportFrame], _spool: Spool) -> Iterator[bytes]:
    for frame in frames:
        decisions = [dict(box.decision) for box in frame.boxes]
        line = {"key": frame.key, "palette": frame.palette, "decisions": decisions}
        yield json_bytes(_with_3d(line, frame)) + b"\n"


def _with_3d(line: dict[str, Any], frame: ExportFrame) -> dict[str, Any]:
    """3D boxes come out as they came in, beside their decisions."""
    for decision, box in zip(line["decisions"], frame.boxes, strict=True):
        for form in ("vertices", "box3d"):
            if form in box.given:
                decision[form] = box.given[form]
    return line


def _csv(frames: Iterator[ExportFrame], _spool: Spool) -> Iterator[bytes]:
    return csv_pieces(_rows(frames))


def _parquet(frames: Iterator[ExportFrame], spool: Spool) -> Iterator[bytes]:

    fill_parquet(require_parquet(), _rows(frames), spool)
    yield from spool.pieces()


def _rows(frames: Iterator[ExportFrame]) -> Iterator[Mapping[str, Any]]:
    for frame in frames:
        for box in frame.boxes:
            yield row_of(frame, box)


_FORMS: Final[Mapping[str, Pieces]] = {
    "jsonl": _jsonl,
    "csv": _csv,
    "parquet": _parquet,
}

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


def _writer(form: str) -> Write:
    def write(
        frames: Iterable[ExportFrame],
        sink: Sink,
        head: ExportHead,
        options: ExportOptions,  # there is none to heed
    ) -> Counts:
        return write_decisions(frames, sink, head, form)

    return write


DECISIONS_JSONL: Final = Format(
    name="decisions-jsonl",
    title="Decisions, JSON lines",
    write=_writer("jsonl"),
    whole_decisions=True,
)

DECISIONS_CSV: Final = Format(
    name="decisions-csv",
    title="Decisions, CSV",
    write=_writer("csv"),
    whole_decisions=True,
)

DECISIONS_PARQUET: Final = Format(
    name="decisions-parquet",
    title="Decisions, Parquet",
    write=_writer("parquet"),
    whole_decisions=True,
    require=require_parquet,
)
