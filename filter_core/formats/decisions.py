"""Every decision of every frame, with any verdict: as JSONL, CSV or Parquet.

JSONL has complete decisions, one line per frame, and is read again, with the answers of
people. The tables have one row per box and one column per plain value; they are written
from columns, without an object for each box.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from filter_core.annotation.frame import FORMS_3D, GEOMETRIES
from filter_core.arrays import counts_or_none, floats_or_none
from filter_core.errors import LayoutError, NotAvailable
from filter_core.formats.export import (
    ExportError,
    ExportFrame,
    ExportHead,
    ExportOptions,
    Sink,
)
from filter_core.formats.files import Spool, json_bytes
from filter_core.formats.format import Format, Recognition, Source
from filter_core.formats.reading import (
    MAX_KEY,
    MAX_LABEL_BYTES,
    FrameSet,
    FrameSource,
    GivenAnswer,
    counted_notes,
    json_object,
    open_regular,
)
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.streams import listed_frames
from filter_core.formats.tally import Counts, ExportTally
from filter_core.values import shown
from filter_core.verdicts import VERDICTS, Answer, DecidedBoxes, DecisionColumns, Reason

DECISIONS_JSONL: Final = Format(
    name="decisions-jsonl",
    title="Decisions, JSON lines",
    docs_row="`decisions.jsonl`: every decision of every frame, one frame per line",
    brief="every number of every box, one frame per line",
    recognised_by="decisions.jsonl",
    read_options=frozenset({"segmentation", "files"}),
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


_NAME: Final = "decisions.jsonl"

_LOOKED_AT: Final = 4096
"""Bytes by which a file is recognised."""

_FIRST_KEYS: Final = re.compile(rb'\s*\{\s*"key"\s*:.*"decisions"\s*:\s*\[', re.DOTALL)


@DECISIONS_JSONL.recogniser
def _recognise(source: Source) -> Recognition:
    is_folder = source.path.is_dir()
    path = source.path / _NAME if is_folder else source.path
    if path.suffix.lower() != ".jsonl" or not path.is_file():
        return "none"
    try:
        with open_regular(path) as file:
            head = file.read(_LOOKED_AT)
    except OSError:
        return "none"
    if not _FIRST_KEYS.match(head):
        return "none"
    # In a folder it may be what `unghost filter` said of the recording there.
    return "fallback" if is_folder else "certain"


@DECISIONS_JSONL.reader
def read_decisions(source: Path, options: RecordingDescription) -> FrameSet:
    """The frames of a file of decisions, with all boxes whatever their verdict.

    Images are those in the folder whose paths end like the keys of the frames. A box
    without a rectangle, as files of earlier versions have it of one outside of the
    image, is left out, and counted. Raises `LayoutError`: no such file, or a line
    without a key.
    """
    path = source / _NAME if source.is_dir() else source
    if not path.is_file():
        raise LayoutError(f"expected {_NAME}, found no such file")
    places = list(_places(path))
    listed = listed_frames(
        path.parent,
        options,
        [(key, f"{key}.png") for key, _, _ in places],
        "line of decisions",
    )
    without: Counter[str] = Counter()

    def frames() -> Iterator[FrameSource]:
        without.clear()
        for frame, (_, start, number) in zip(listed, places, strict=True):
            if frame.problem:
                yield frame
                continue
            try:
                with open_regular(path) as file:
                    file.seek(start)
                    content = file.readline(MAX_LABEL_BYTES + 1)
                line = _object(content, f"{path.name}, line {number}")
                annotation = _annotation(line, without)
                yield replace(frame, annotation=annotation, answers=_answers(line))
            except LayoutError as problem:
                yield replace(frame, problem=problem)

    return replace(
        listed,
        layout=DECISIONS_JSONL.name,
        frames=frames,
        notes=lambda: (*listed.notes(), *counted_notes(without, _NOTES)),
        texts=lambda: [path],
    )


def _places(path: Path) -> Iterator[tuple[str, int, int]]:
    """The key of each frame, the first byte of its line, and the line's number."""
    start = 0
    with open_regular(path) as file:
        for number, line in enumerate(
            iter(lambda: file.readline(MAX_LABEL_BYTES + 1), b""), start=1
        ):
            if line.strip():
                key = _object(line, f"{path.name}, line {number}").get("key")
                if not isinstance(key, str) or not 0 < len(key) <= MAX_KEY:
                    raise LayoutError(
                        f'{path.name}, line {number}: expected "key" of 1 to {MAX_KEY} '
                        f"characters, found {shown(key)}"
                    )
                yield key, start, number
            start += len(line)


def _object(line: bytes, at: str) -> Mapping[str, object]:
    if len(line) > MAX_LABEL_BYTES:
        raise LayoutError(f"{at}: expected at most {MAX_LABEL_BYTES} bytes, found more")
    return json_object(line, at, halves=True)


_OF_FRAME: Final = ("camera", "carla_version", "captured_at", "map")
_OF_SPLIT: Final = ("sequence", "split")

_OF_BOX: Final = (
    "id",
    "class",
    "type_id",
    "base_type",
    "instance_id",
    "distance",
    "distance_range",
)


def _decisions(line: Mapping[str, object]) -> Iterator[Mapping[str, object]]:
    decisions = line.get("decisions")
    if not isinstance(decisions, list):
        raise LayoutError(f"expected a list of decisions, found {shown(decisions)}")
    yield from (decision for decision in decisions if isinstance(decision, dict))


def _annotation(line: Mapping[str, object], without: Counter[str]) -> dict[str, object]:
    """The annotation that a line was made of, as far as it tells."""
    kept = {
        key: line[key] for key in (*_OF_FRAME, *_OF_SPLIT) if line.get(key) is not None
    }
    boxes = []
    for decision in _decisions(line):
        raw = decision.get("given")
        geometry = dict(raw) if isinstance(raw, Mapping) else {}
        geometry |= {form: decision[form] for form in FORMS_3D if form in decision}
        if not geometry and decision.get("xyxy") is not None:
            geometry = {"xyxy": decision["xyxy"]}
        if geometry:
            own = {
                key: decision[key] for key in _OF_BOX if decision.get(key) is not None
            }
            boxes.append({**own, **geometry})
        else:
            without["boxes"] += 1
    return {**kept, "boxes": boxes}


def _answers(line: Mapping[str, object]) -> list[GivenAnswer]:
    """The answers of people on the boxes of a line; without a time, from 1970."""
    return [
        GivenAnswer(
            str(decision.get("id")),
            str(review.get("verdict")),
            str(review.get("reviewer")),
            str(review.get("comment") or ""),
            str(review.get("created_at") or _UNKNOWN_TIME),
        )
        for decision in _decisions(line)
        if isinstance(review := decision.get("review"), dict)
    ]


_UNKNOWN_TIME: Final = "1970-01-01T00:00:00Z"
"""Of answers in files of earlier versions: any other answer is newer."""


_NOTES: Final = {"boxes": "{:,} boxes have no rectangle; they are left out"}


def _write(
    frames: Iterable[ExportFrame],
    sink: Sink,
    head: ExportHead,
    _options: ExportOptions,
    pieces: Callable[[Iterator[ExportFrame], Spool, ExportHead], Iterable[bytes]],
) -> Counts:
    """Write every decision of every frame, and ``manifest.json``; returns its counts.

    Frames are read once, one at a time. `pieces` gives the content of the file; it may
    use the spool for it.
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
    """A line for each frame; what its decisions do not tell is written as given."""
    for frame in frames:
        decisions = [
            {**decision, **_given(decision, box)}
            for decision, box in zip(frame.decisions, frame.given.boxes, strict=True)
        ]
        annotation = frame.given.frame
        # The camera, if all of it is known; else the size of the image
        line = {
            "key": frame.key,
            "palette": frame.palette,
            **{
                key: annotation[key]
                for key in _OF_FRAME
                if annotation.get(key) is not None
            },
            **({} if frame.map is None else {"map": frame.map}),
            **({} if frame.sequence is None else {"sequence": frame.sequence}),
            **({} if frame.split is None else {"split": frame.split}),
            "camera": (
                frame.given.frame["camera"]
                if frame.given.camera is not None
                else {"width": frame.wh[0], "height": frame.wh[1]}
            ),
            "decisions": decisions,
        }
        yield json_bytes(line) + b"\n"


def _given(
    decision: Mapping[str, object], box: Mapping[str, object]
) -> dict[str, object]:
    """What was given for a box: its 3D form, or a rectangle that was corrected."""
    own = {key: box[key] for key in _GIVEN if key in box and key not in decision}
    form = next(form for form in GEOMETRIES if form in box)
    if form in FORMS_3D:
        return {**own, form: box[form]}
    if form == "xyxy" and box[form] == decision.get("xyxy"):
        return own
    return {**own, "given": {form: box[form]}}


_GIVEN: Final = ("type_id", "base_type", "instance_id")


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

_RANGE: Final = ("distance_from", "distance_to")
"""The columns of `Decision`'s ``distance_range``."""

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
    **dict.fromkeys(_RANGE, float),
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
        if frame.columns is None:
            raise ExportError(f"{frame.key}: the columns of its decisions are missing")
        count = len(frame.boxes)
        waiting["frame"] += [frame.key] * count
        waiting["map"] += [frame.map] * count
        for name, column in table_columns(frame.boxes, frame.columns).items():
            waiting[name].extend(column())
        while len(waiting["box"]) >= size:
            yield {name: values[:size] for name, values in waiting.items()}
            waiting = {name: values[size:] for name, values in waiting.items()}
    if waiting["box"]:
        yield dict(waiting)


def table_columns(
    boxes: DecidedBoxes, more: DecisionColumns
) -> dict[str, Callable[[], Sequence[object]]]:
    """The columns of a table of N boxes, as functions that give the N plain values.

    Under the names of `COLUMNS`, without those of the frames. A missing value is None.
    """
    corners = dict(zip(_CORNERS, boxes.xyxy.T, strict=True))
    ranges = dict(zip(_RANGE, boxes.distance_range.T, strict=True))
    verdicts = [verdict.value for verdict in VERDICTS]
    return {
        "box": lambda: boxes.ids,
        "class": lambda: _named(boxes.class_names, boxes.class_index),
        "verdict": lambda: _named(verdicts, boxes.verdict),
        "effective_verdict": lambda: _named(verdicts, boxes.effective),
        "reason": lambda: _named(_REASONS, boxes.reason),
        "match_percent": lambda: floats_or_none(boxes.match_percent),
        "threshold": lambda: floats_or_none(more.threshold),
        "margin": lambda: floats_or_none(more.margin),
        "toss_up": more.toss_up.tolist,
        "large": more.large.tolist,
        "matched_pixels": lambda: counts_or_none(more.matched_pixels),
        "box_pixels": more.box_pixels.tolist,
        "unknown_pixels": lambda: counts_or_none(more.unknown_pixels),
        "area_percent": lambda: floats_or_none(more.area_percent),
        "crowding": lambda: floats_or_none(more.crowding),
        "explained_by": lambda: more.explained_by,
        "hidden_by": lambda: [
            "; ".join(f"{tag['name']} {tag['percent']:.1f}" for tag in tags)
            for tags in more.hidden_by
        ],
        "lossy": boxes.lossy.tolist,
        "distance": lambda: floats_or_none(boxes.distance),
        **{name: partial(floats_or_none, column) for name, column in corners.items()},
        "review": lambda: _named(_ANSWERS, boxes.answer),
        "reviewer": lambda: more.reviewer,
        "comment": lambda: more.comment,
        "config": lambda: [more.config] * len(boxes),
        **{name: partial(floats_or_none, column) for name, column in ranges.items()},
    }


def _named(
    names: Sequence[object], index: NDArray[np.uint8] | NDArray[np.int32]
) -> list[object]:
    return [names[place] for place in index.tolist()]


_REASONS: Final = [
    Reason(code).label if code else "" for code in range(len(Reason) + 1)
]
"""The names of reasons by their numbers, which start at 1."""

_ANSWERS: Final = [None, *(answer.name.lower() for answer in Answer if answer)]
"""What a person said, by the number of the `Answer`."""


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

    Raises `NotAvailable`: it is not installed; the message says how to get it.
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
            # Text that can be encoded: half a surrogate pair becomes ``?``.
            columns = {
                name: [
                    value.encode("utf-8", "replace").decode()
                    if isinstance(value, str)
                    else value
                    for value in values
                ]
                for name, values in rows.items()
            }
            writer.write_table(pyarrow.Table.from_pydict(columns, schema=schema))
    yield from spool.pieces()


DECISIONS_PARQUET.writer(partial(_write, pieces=_parquet))
