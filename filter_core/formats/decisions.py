"""Decisions as rows of a table: one column for each plain value."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

from filter_core.formats.export import ExportBox, ExportFrame

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
