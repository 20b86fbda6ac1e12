"""Label Studio: tasks with the filter's predictions and people's annotations.

References
----------
.. [1] HumanSignal, "Label Studio JSON format of annotated tasks",
   https://labelstud.io/guide/task_format
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import ClassVar, Final
from urllib.parse import quote

from filter_core.formats.export import ExportFrame
from filter_core.formats.files import attributes
from filter_core.formats.format import LABEL_NEEDS, LABEL_OPTIONS, Format
from filter_core.formats.writing import (
    ExportContext,
    LabelBoxes,
    OutFrame,
    Traits,
)

LABEL_STUDIO: Final = Format(
    name="label-studio",
    title="Label Studio",
    docs_row=(
        "`tasks.json`: the filter's verdicts as predictions with scores, people's "
        "answers as annotations; `label_config.xml` for the project"
    ),
    brief="tasks with predictions",
    needs=LABEL_NEEDS,
    options=LABEL_OPTIONS,
)

_LOCAL_FILES: Final = "/data/local-files/?d="
"""The address of files below Label Studio's LOCAL_FILES_DOCUMENT_ROOT."""


@LABEL_STUDIO.label_writer
class LabelStudioWriter:
    """Writes ``tasks.json``, ``label_config.xml`` and ``images/STEM.png``.

    Rectangles are in percent of the image. A box that the filter decided is a
    prediction, with its share of matching pixels as score; one that a person decided is
    an annotation.
    """

    traits: ClassVar[Traits] = Traits(image="images/{stem}{suffix}")

    def __init__(self, context: ExportContext) -> None:
        self._context = context
        self._tasks = context.spool()

    def labels(self, band: str, out: OutFrame) -> None:
        """One task."""
        reviewed = out.frame.boxes.is_reviewed[out.boxes.row]
        by_people = _regions(out.boxes[reviewed], out.frame)
        task = {
            "id": out.number + 1,
            "data": {
                "image": _LOCAL_FILES + quote(out.image),
                "key": out.frame.key,
                "map": out.frame.map,
                "split": out.part,
            },
            "predictions": [self._prediction(out.boxes[~reviewed], out.frame)],
            "annotations": (
                [{"result": by_people, "ground_truth": False}] if by_people else []
            ),
        }
        self._tasks.add(task)

    def finish(self) -> None:
        """The tasks, and the labelling interface that shows them."""
        self._context.sink("tasks.json", self._pieces())
        config = _label_config(self._context.head.classes)
        self._context.sink("label_config.xml", [config.encode("utf-8", "replace")])

    def _prediction(self, chosen: LabelBoxes, frame: ExportFrame) -> dict[str, object]:
        digest = self._context.head.facts.get("config")
        found = (_score(row, frame) for row in chosen.row.tolist())
        scores = [score for score in found if score is not None]
        return {
            "model_version": f"unghost-{str(digest)[:12]}" if digest else "unghost",
            "score": min(scores, default=None),
            "result": _regions(chosen, frame),
        }

    def _pieces(self) -> Iterator[bytes]:
        yield b"["
        yield from self._tasks.pieces()
        yield b"\n]\n"


def _regions(chosen: LabelBoxes, frame: ExportFrame) -> list[dict[str, object]]:
    return [_region(one.row, one.xyxy, frame) for one in chosen]


def _region(row: int, xyxy: Sequence[float], frame: ExportFrame) -> dict[str, object]:
    boxes = frame.boxes
    (x_min, y_min, x_max, y_max), (width, height) = xyxy, frame.wh
    value = {
        "x": _percent(x_min, width),
        "y": _percent(y_min, height),
        "width": _percent(x_max - x_min, width),
        "height": _percent(y_max - y_min, height),
        "rotation": 0,
        "rectanglelabels": [boxes.class_name(row)],
    }
    score = _score(row, frame)
    return {
        "id": boxes.ids[row],
        "type": "rectanglelabels",
        "from_name": "label",
        "to_name": "image",
        "original_width": width,
        "original_height": height,
        "image_rotation": 0,
        "value": value,
        **({} if score is None else {"score": score}),
        "meta": {
            "text": [f"{boxes.effective_verdict(row)}: {boxes.reason_label(row)}"],
        },
    }


_DECIMALS: Final = 6


def _percent(part: float, side: int) -> float:
    return round(100 * part / side, _DECIMALS)


def _score(row: int, frame: ExportFrame) -> float | None:
    """The share of a box's pixels that match; None if they were not measured."""
    match = float(frame.boxes.match_percent[row])
    return None if math.isnan(match) else match / 100


def _label_config(classes: Sequence[str]) -> str:
    labels = "".join(f"    <Label{attributes(value=name)}/>\n" for name in classes)
    return (
        '<View>\n  <Image name="image" value="$image"/>\n'
        '  <RectangleLabels name="label" toName="image">\n'
        f"{labels}  </RectangleLabels>\n</View>\n"
    )
