"""Label Studio: tasks with the filter's predictions and people's annotations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any, ClassVar, Final
from urllib.parse import quote

from filter_core.formats.files import attributes
from filter_core.formats.format import LABEL_OPTIONS, Format
from filter_core.formats.writing import (
    ExportContext,
    OutBox,
    OutFrame,
    Traits,
    write_labels,
)

_LOCAL_FILES: Final = "/data/local-files/?d="
"""How Label Studio is told of a file below its LOCAL_FILES_DOCUMENT_ROOT."""

_DECIMALS: Final = 6


class LabelStudioWriter:
    """Writes ``tasks.json``, ``label_config.xml`` and ``images/STEM.png``.

    Rectangles are percent of the image. What goes out by the filter's verdict is a
    prediction, with the share of matching pixels as its score; what a person decided
    is an annotation.

    References
    ----------
    .. [1] HumanSignal, "Label Studio JSON format of annotated tasks",
       https://labelstud.io/guide/task_format
    """

    traits: ClassVar[Traits] = Traits("label-studio")

    def __init__(self, context: ExportContext) -> None:
        self._context = context
        self._tasks = context.spool()

    def image(self, out: OutFrame) -> str:
        """The name of a frame's image in the export."""
        return f"images/{out.stem}{out.suffix}"

    def labels(self, band: str, out: OutFrame) -> None:
        """One task."""
        by_filter = [one for one in out.boxes if not one.box.is_reviewed]
        by_people = [one for one in out.boxes if one.box.is_reviewed]
        task: dict[str, Any] = {
            "id": out.number + 1,
            "data": {
                "image": _LOCAL_FILES + quote(self.image(out)),
                "key": out.frame.key,
                "map": out.frame.map,
                "split": out.part,
            },
            "predictions": [_prediction(by_filter, out.frame.wh, self._version())],
            "annotations": [],
        }
        if by_people:
            result = [_region(one, out.frame.wh) for one in by_people]
            task["annotations"] = [{"result": result, "ground_truth": False}]
        self._tasks.add(task)

    def finish(self) -> None:
        """The tasks, and the labelling interface that shows them."""
        self._context.sink("tasks.json", self._pieces())
        config = _label_config(self._context.head.classes)
        self._context.sink("label_config.xml", [config.encode("utf-8", "replace")])

    def _version(self) -> str:
        digest = self._context.head.facts.get("config")
        return f"unghost-{str(digest)[:12]}" if digest else "unghost"

    def _pieces(self) -> Iterator[bytes]:
        yield b"["
        yield from self._tasks.pieces()
        yield b"\n]\n"


def _prediction(
    boxes: Sequence[OutBox], wh: tuple[int, int], version: str
) -> dict[str, Any]:
    result = [_region(one, wh) for one in boxes]
    scores = [region["score"] for region in result if "score" in region]
    score = min(scores) if scores else None
    return {"model_version": version, "score": score, "result": result}


def _region(one: OutBox, wh: tuple[int, int]) -> dict[str, Any]:
    (x_min, y_min, x_max, y_max), (width, height) = one.xyxy, wh
    value = {
        "x": _percent(x_min, width),
        "y": _percent(y_min, height),
        "width": _percent(x_max - x_min, width),
        "height": _percent(y_max - y_min, height),
        "rotation": 0,
        "rectanglelabels": [one.box.class_name],
    }
    match = one.box.decision.get("match_percent")
    score = {"score": match / 100} if isinstance(match, (int, float)) else {}
    return {
        "id": one.box.id,
        "type": "rectanglelabels",
        "from_name": "label",
        "to_name": "image",
        "original_width": width,
        "original_height": height,
        "image_rotation": 0,
        "value": value,
        **score,
        "meta": {
            "text": [f"{one.box.verdict}: {one.box.decision['reason']}"],
        },
    }


def _percent(part: float, side: int) -> float:
    return round(100 * part / side, _DECIMALS)


def _label_config(classes: Sequence[str]) -> str:
    labels = "".join(f"    <Label{attributes(value=name)}/>\n" for name in classes)
    return (
        '<View>\n  <Image name="image" value="$image"/>\n'
        '  <RectangleLabels name="label" toName="image">\n'
        f"{labels}  </RectangleLabels>\n</View>\n"
    )


LABEL_STUDIO: Final = Format(
    name="label-studio",
    title="Label Studio",
    write=partial(write_labels, new_writer=LabelStudioWriter),
    options=LABEL_OPTIONS,
)
