"""CVAT for images 1.1: one XML file for all images."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import ClassVar, Final

from filter_core.formats.files import attributes, element, escaped, number_text
from filter_core.formats.format import LABEL_OPTIONS, Format
from filter_core.formats.writing import (
    ExportContext,
    OutBox,
    OutFrame,
    Traits,
    write_labels,
)

_VERDICT_VALUES: Final = "kept\nrejected\nunmeasured"


class CvatWriter:
    """Writes ``annotations.xml`` and ``images/STEM.png``.

    Corners are pixels from 0. Each box has the attributes ``id``, ``verdict`` and
    ``reason``; the labels in the file's head declare them, so that a task can be made
    with the same. A rejected box that was asked for is occluded.

    References
    ----------
    .. [1] CVAT, "CVAT for image", https://docs.cvat.ai/docs/dataset_management/formats/
    """

    traits: ClassVar[Traits] = Traits("cvat")

    def __init__(self, context: ExportContext) -> None:
        self._context = context
        self._images = context.spool()

    def image(self, out: OutFrame) -> str:
        """The name of a frame's image in the export."""
        return f"images/{out.stem}{out.suffix}"

    def labels(self, band: str, out: OutFrame) -> None:
        """One image with its boxes."""
        width, height = out.frame.wh
        head = attributes(
            id=out.number,
            name=f"{out.stem}{out.suffix}",
            width=width,
            height=height,
        )
        boxes = "".join(map(_box, out.boxes))
        text = f"  <image{head}>\n{boxes}  </image>\n"
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


def _box(one: OutBox) -> str:
    corners = zip(("xtl", "ytl", "xbr", "ybr"), one.xyxy, strict=True)
    head = attributes(
        label=one.box.class_name,
        source="auto",
        occluded=int(one.box.verdict == "rejected"),
        **{key: number_text(value) for key, value in corners},
        z_order=0,
    )
    said = {
        "id": one.box.id,
        "verdict": one.box.verdict,
        "reason": one.box.decision["reason"],
    }
    lines = "".join(f"      {_attribute(key, value)}\n" for key, value in said.items())
    return f"    <box{head}>\n{lines}    </box>\n"


def _attribute(name: str, value: object) -> str:
    return f"<attribute{attributes(name=name)}>{escaped(value)}</attribute>"


CVAT: Final = Format(
    name="cvat",
    title="CVAT for images 1.1",
    write=partial(write_labels, new_writer=CvatWriter),
    options=LABEL_OPTIONS - {"split"},
)
