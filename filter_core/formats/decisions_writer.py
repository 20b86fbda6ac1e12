"""Every decision of every frame: as JSONL, CSV, or Parquet."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, Final, TypeAlias

from filter_core.errors import NotAvailable
from filter_core.formats.decisions import csv_pieces, row_of
from filter_core.formats.export import ExportFrame, ExportHead, Sink
from filter_core.formats.spool import Spool, json_bytes
from filter_core.formats.tally import Counts, ExportTally

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
    from filter_core.formats.parquet import fill_parquet

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
