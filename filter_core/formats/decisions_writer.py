"""Decisions as JSONL: one frame per line, in the order they come."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Final

from filter_core.formats.export_frame import ExportFrame, ExportHead, Sink
from filter_core.formats.export_tally import ExportTally

DECISIONS_NAME: Final = "decisions.jsonl"


def json_line(value: Mapping[str, object]) -> bytes:
    """One line of a JSONL file; the same value always gives the same bytes."""
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    return text.encode() + b"\n"


def write_decisions(
    frames: Iterable[ExportFrame],
    sink: Sink,
    head: ExportHead,
) -> None:
    """Every decision of every frame, and the books of the export.

    Parameters
    ----------
    frames : iterable of ExportFrame
        Read once, one at a time.
    sink : callable
        Gets ``decisions.jsonl``, then ``manifest.json``.
    head : ExportHead

    Raises
    ------
    ExportError
        As `ExportTally.counts`.
    """
    with ExportTally(head) as tally:
        sink(DECISIONS_NAME, _lines(frames, tally))
        sink("manifest.json", tally.manifest("decisions-jsonl"))


def _lines(frames: Iterable[ExportFrame], tally: ExportTally) -> Iterator[bytes]:
    for frame in frames:
        tally.frame(frame)
        for box in frame.boxes:
            tally.box(box)
            tally.written(frame, box, clipped=False)
        decisions = [dict(box.decision) for box in frame.boxes]
        line = {"key": frame.key, "palette": frame.palette, "decisions": decisions}
        yield json_line(line)
