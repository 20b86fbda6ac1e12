"""CVAT for images 1.1: one XML file for all images.

References
----------
.. [1] CVAT, "CVAT for image", https://docs.cvat.ai/docs/dataset_management/formats/
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar, Final

from filter_core.formats.files import attributes, element, escaped, number_text
from filter_core.formats.format import LABEL_NEEDS, LABEL_OPTIONS, Format
from filter_core.formats.writing import (
    ExportContext,
    LabelBox,
    OutFrame,
    Traits,
)
from filter_core.types import DecidedBoxes

CVAT: Final = Format(
    name="cvat",
    title="CVAT for images 1.1",
    docs_row="`annotations.xml` with id, verdict and reason of each box as attributes",
    brief="XML for CVAT's images task",
    needs=LABEL_NEEDS,
    options=LABEL_OPTIONS - {"split"},
)


@CVAT.label_writer
class CvatWriter:
    """Writes ``annotations.xml`` and ``images/STEM.png``.

    Corners are pixels from 0. Each box has the attributes ``id``, ``verdict`` and
    ``reason``; the head of the file declares them, so that a CVAT task can be made with
    the same labels. Where rejected boxes are exported too, they are marked as occluded.
    """

    traits: ClassVar[Traits] = Traits(image="images/{stem}{suffix}")

    def __init__(self, context: ExportContext) -> None:
        self._context = context
        self._images = context.spool()  # a temporary file

    def labels(self, band: str, out: OutFrame) -> None:
        """One image with its boxes.

        `band` is always empty: only some formats can be exported in bands of distance.
        """
        width, height = out.frame.wh
        image = attributes(
            id=out.number,
            name=f"{out.stem}{out.suffix}",
            width=width,
            height=height,
        )
        boxes = "".join(_box(one, out.frame.boxes) for one in out.boxes)
        text = f"  <image{image}>\n{boxes}  </image>\n"
        self._images.write(text.encode("utf-8", "replace"))

    def finish(self) -> None:
        """The file, now that all images are known."""
        self._context.sink("annotations.xml", self._pieces())

    def _pieces(self) -> Iterator[bytes]:
        yield b'<?xml version="1.0" encoding="utf-8"?>\n<annotations>\n'
        yield b"  <version>1.1</version>\n  <meta>\n    <task>\n      <labels>\n"
        for name in self._context.head.classes:
            yield _label(name).encode("utf-8", "replace")
        yield b"      </labels>\n    </task>\n  </meta>\n"
        yield from self._images.pieces()
        yield b"</annotations>\n"


_VERDICT_VALUES: Final = "kept\nrejected\nunmeasured"


def _label(name: str) -> str:
    declared = "".join(
        f"<attribute>{element('name', key)}<mutable>False</mutable>"
        f"{element('input_type', kind)}<default_value></default_value>"
        f"{element('values', values)}</attribute>"
        for key, kind, values in (
            ("id", "text", ""),
            ("verdict", "select", _VERDICT_VALUES),
            ("reason", "text", ""),
        )
    )
    return (
        f"        <label>{element('name', name)}"
        f"<attributes>{declared}</attributes></label>\n"
    )


def _box(one: LabelBox, boxes: DecidedBoxes) -> str:
    verdict = boxes.effective_verdict(one.row)
    corners = zip(("xtl", "ytl", "xbr", "ybr"), one.xyxy, strict=True)
    box = attributes(
        label=boxes.class_name(one.row),
        source="auto",
        occluded=int(verdict == "rejected"),
        **{key: number_text(value) for key, value in corners},
        z_order=0,
    )
    details = {
        "id": boxes.ids[one.row],
        "verdict": verdict,
        "reason": boxes.reason_label(one.row),
    }
    lines = "".join(
        f"      {_attribute(key, value)}\n" for key, value in details.items()
    )
    return f"    <box{box}>\n{lines}    </box>\n"


def _attribute(name: str, value: object) -> str:
    return f"<attribute{attributes(name=name)}>{escaped(value)}</attribute>"
