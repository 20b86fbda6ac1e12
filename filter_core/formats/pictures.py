"""Pictures of the first frames of an export: before and after, a sheet and a page."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterator
from typing import Final

from filter_core.formats.export import ExportFrame, Sink
from filter_core.images.drawing import DrawnBox, Picture, as_png, decoded
from filter_core.images.sheet import (
    MOST_TILES,
    figure_of,
    page_of,
    sheet_of,
    tile_of,
)
from filter_core.verdicts import KEPT, VERDICTS, DecidedBoxes, VerdictName

PICTURES: Final = "pictures"
"""The folder in an export."""


def drawn_boxes(
    boxes: DecidedBoxes,
    verdict: VerdictName | None = None,
    only: Collection[int] | None = None,
    *,
    metres: bool = False,
) -> Iterator[DrawnBox]:
    """The boxes in the image; with their distance in whole metres, if asked.

    `verdict` is drawn in place of their own; `only` are the rows that are drawn.
    """
    columns = (boxes.distance.tolist(), boxes.xyxy.tolist(), boxes.effective.tolist())
    for row, (away, xyxy, own) in enumerate(zip(*columns, strict=True)):
        if math.isnan(xyxy[0]) or (only is not None and row not in only):
            continue
        text = str(int(away)) if metres and not math.isnan(away) else ""
        yield DrawnBox(verdict or VERDICTS[own].value, xyxy, None, text)


class ExportPictures:
    """Draws the first frames of an export that have an image, at most `most`."""

    def __init__(self, sink: Sink, most: int) -> None:
        self._sink, self._most = sink, most
        self._figures: list[str] = []
        self._tiles: list[Picture] = []
        self._reasons: Counter[str] = Counter()

    def add(self, frame: ExportFrame, stem: str, written: Collection[int]) -> None:
        """Draw a frame, of whose boxes those in the rows `written` are written."""
        if len(self._figures) >= self._most or frame.draw is None:
            return
        name, boxes = f"{stem.replace('/', '__')}.png", frame.boxes
        before = frame.draw(list(drawn_boxes(boxes, "kept")))
        after = frame.draw(list(drawn_boxes(boxes, "kept", written)))
        for folder, content in (("before", before), ("after", after)):
            self._sink(f"{PICTURES}/{folder}/{name}", [content])
        if len(self._tiles) < MOST_TILES:
            count = f"{len(written)} of {len(boxes)} boxes"
            caption = f"{frame.key}: {count}"
            # Both were drawn here, and are no files of other people.
            self._tiles.append(tile_of(decoded(before), decoded(after), caption))
        gone = [row for row, code in enumerate(boxes.effective) if code != KEPT]
        rows = [
            (f"{boxes.class_name(row)} {boxes.ids[row]}", boxes.reason_label(row))
            for row in gone
        ]
        self._reasons.update(reason for _, reason in rows)
        words = f"{len(written)} of {len(boxes)} boxes are written."
        self._figures.append(figure_of(frame.key, name, words, rows))

    def finish(self, name: str) -> None:
        """The contact sheet and the page."""
        sheet = sheet_of(self._tiles)
        if sheet is None:
            return
        self._sink(f"{PICTURES}/sheet.png", [as_png(sheet)])
        page = page_of(name, self._figures, self._reasons)
        self._sink(f"{PICTURES}/index.html", [page.encode("utf-8", "replace")])
