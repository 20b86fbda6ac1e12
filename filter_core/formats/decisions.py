"""Every decision of every frame, with any verdict: as JSONL, CSV or Parquet.

JSONL has complete decisions, one line per frame. The tables have one row per box and
one column per plain value; they are written from columns, without an object for each
box.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from types import ModuleType
from typing import Final, TypeAlias

from filter_core.annotation.frame import FORMS_3D
from filter_core.errors import NotAvailable
from filter_core.formats.export import (
    ExportError,
    ExportFrame,
    ExportHead,
    ExportOptions,
    Sink,
)
from filter_core.formats.files import Spool, json_bytes
from filter_core.formats.format import Format
from filter_core.formats.tally import Counts, ExportTally
from filter_core.types import (
    VERDICTS,
    Answer,
    HiddenBy,
    Reason,
    counts_or_none,
    floats_or_none,
)

DECISIONS_JSONL: Final = Format(
    name="decisions-jsonl",
    title="Decisions, JSON lines",
    docs_row="`decisions.jsonl`: every decision of every frame, one frame per line",
    brief="every number of every box, one frame per line",
    needs=frozenset({"decisions", "annotation"}),
)

DECISIONS_CSV: Final = Format(
    name="decisions-csv",
    title="Decisions, CSV",
    docs_row="`decisions.csv`: one row per box, for spreadsheets",
    brief="one row per box, for spreadsheets",
    needs=frozenset({"decision_columns"}),
)

DECISIONS_PARQUET: Final = Format(
    name="decisions-parquet",
    title="Decisions, Parquet",
    docs_row=(
        "`decisions.parquet`: the same, for data frames; needs `pip install "
        "'unghost[parquet]'`"
    ),
    brief="one row per box, for data frames",
    needs=frozenset({"decision_columns"}),
)


def _write(
    frames: Iterable[ExportFrame],
    sink: Sink,
    head: ExportHead,
    _options: ExportOptions,
    pieces: Callable[[Iterator[ExportFrame], Spool, ExportHead], Iterable[bytes]],
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
        Gives the content of the file; it may use the spool for it.

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
    with ExportTally(head) as tally, Spool(head.temporary, head.buffer_bytes) as spool:
        name = head.format.replace("-", ".")  # decisions.jsonl and so on
        sink(name, pieces(_counted(frames, tally), spool, head))
        sink("manifest.json", tally.manifest())
        return tally.counts()


def _counted(
    frames: Iterable[ExportFrame], tally: ExportTally
) -> Iterator[ExportFrame]:
    for frame in frames:
        tally.frame(frame)
        tally.written(tally.count_boxes(frame))
        yield frame


def _jsonl(
    frames: Iterator[ExportFrame], _spool: Spool, _head: ExportHead
) -> Iterator[bytes]:
    """A line for each frame; 3D boxes are written as given."""
    for frame in frames:
        decisions = [
            {**decision, **{form: box[form] for form in FORMS_3D if form in box}}
            for decision, box in zip(frame.decisions, frame.given.boxes, strict=True)
        ]
        line = {"key": frame.key, "palette": frame.palette, "decisions": decisions}
        yield json_bytes(line) + b"\n"


DECISIONS_JSONL.writer(partial(_write, pieces=_jsonl))


_ROWS_AT_ONCE: Final = 500


def _csv(
    frames: Iterator[ExportFrame], _spool: Spool, head: ExportHead
) -> Iterator[bytes]:
    """RFC 4180 with a header, some hundred rows at a time."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\r\n")
    writer.writerow(COLUMNS)
    for rows in _groups(frames, min(_ROWS_AT_ONCE, head.group_rows)):
        columns = [_cells(rows[name], kind) for name, kind in COLUMNS.items()]
        writer.writerows(zip(*columns, strict=True))
        yield _drained(text)
    yield _drained(text)


DECISIONS_CSV.writer(partial(_write, pieces=_csv))


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
    "unknown_pixels": int,
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


_Columns: TypeAlias = dict[str, Sequence[object]]
"""Lists of equal length under the names of `COLUMNS`; None where a value is missing."""


def _groups(frames: Iterable[ExportFrame], size: int) -> Iterator[_Columns]:
    """The boxes of all frames, `size` at a time; fewer at the end."""
    waiting: dict[str, list[object]] = {name: [] for name in COLUMNS}
    for frame in frames:
        if not len(frame.boxes):
            continue
        for name, values in _columns_of(frame).items():
            waiting[name].extend(values)
        while len(waiting["box"]) >= size:
            yield {name: values[:size] for name, values in waiting.items()}
            waiting = {name: values[size:] for name, values in waiting.items()}
    if waiting["box"]:
        yield dict(waiting)


def _columns_of(frame: ExportFrame) -> _Columns:
    boxes, more = frame.boxes, frame.columns
    if more is None:
        raise ExportError(f"{frame.key}: the columns of its decisions are missing")
    corners = dict(zip(_CORNERS, boxes.xyxy.T, strict=True))
    names = [boxes.class_names[index] for index in boxes.class_index.tolist()]
    found: _Columns = {
        "frame": [frame.key] * len(boxes),
        "map": [frame.map] * len(boxes),
        "box": boxes.ids,
        "class": names,
        "verdict": [VERDICTS[code].value for code in boxes.verdict.tolist()],
        "effective_verdict": [
            VERDICTS[code].value for code in boxes.effective.tolist()
        ],
        "reason": [Reason(code).label for code in boxes.reason.tolist()],
        "match_percent": floats_or_none(boxes.match_percent),
        "threshold": floats_or_none(more.threshold),
        "margin": floats_or_none(more.margin),
        "toss_up": more.toss_up.tolist(),
        "large": more.large.tolist(),
        "matched_pixels": counts_or_none(more.matched_pixels),
        "box_pixels": more.box_pixels.tolist(),
        "unknown_pixels": counts_or_none(more.unknown_pixels),
        "area_percent": floats_or_none(more.area_percent),
        "crowding": floats_or_none(more.crowding),
        "explained_by": more.explained_by,
        "hidden_by": [_tags_in_words(tags) for tags in more.hidden_by],
        "lossy": boxes.lossy.tolist(),
        "distance": floats_or_none(boxes.distance),
        **{name: floats_or_none(column) for name, column in corners.items()},
        "review": [_ANSWERS[code] for code in boxes.answer.tolist()],
        "reviewer": more.reviewer,
        "comment": more.comment,
        "config": [more.config] * len(boxes),
    }
    return found


_ANSWERS: Final = [None, *(answer.name.lower() for answer in Answer if answer)]
"""What a person said, by the number of the `Answer`."""


def _tags_in_words(tags: Sequence[HiddenBy]) -> str:
    return "; ".join(f"{tag['name']} {tag['percent']:.1f}" for tag in tags)


_FORMULA: Final = ("=", "+", "-", "@", "\t", "\r", "\n")


def _cells(column: Sequence[object], kind: type) -> Sequence[object]:
    """A column as CSV text; text that looks like a formula gets an apostrophe."""
    if kind is bool:
        return ["true" if value else "false" for value in column]
    if kind is str:
        return [
            f"'{value}"
            if isinstance(value, str) and value.startswith(_FORMULA)
            else value
            for value in column
        ]
    # The writer leaves a cell empty where there is None.
    return column


def _drained(text: io.StringIO) -> bytes:
    """Returns the buffered text and empties the buffer."""
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


_TYPES: Final = {str: "string", float: "float64", int: "int64", bool: "bool_"}


def _parquet(
    frames: Iterator[ExportFrame], spool: Spool, head: ExportHead
) -> Iterator[bytes]:
    """A group of rows at a time, into a file first: Parquet's index comes last."""
    pyarrow = require_parquet()
    schema = pyarrow.schema(
        [(name, getattr(pyarrow, _TYPES[kind])()) for name, kind in COLUMNS.items()]
    )
    target = pyarrow.PythonFile(spool.file, mode="w")
    with pyarrow.parquet.ParquetWriter(target, schema, compression="zstd") as writer:
        for rows in _groups(frames, head.group_rows):
            columns = {
                name: _encodable(rows[name]) if kind is str else rows[name]
                for name, kind in COLUMNS.items()
            }
            writer.write_table(pyarrow.Table.from_pydict(columns, schema=schema))
    yield from spool.pieces()


DECISIONS_PARQUET.writer(partial(_write, pieces=_parquet))


def _encodable(column: Sequence[object]) -> list[object]:
    """Text that can be encoded: half a surrogate pair becomes ``?``."""
    return [
        value.encode("utf-8", "replace").decode() if isinstance(value, str) else value
        for value in column
    ]
