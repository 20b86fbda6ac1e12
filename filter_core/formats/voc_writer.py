"""Pascal VOC: one XML file per image, whole pixels counted from 1."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import ClassVar

from filter_core.formats.export_boxes import OutBox, Traits
from filter_core.formats.writing import PARTS, Desk, OutFrame
from filter_core.formats.xml_text import element


class VocWriter:
    """Writes ``Annotations/STEM.xml``, ``JPEGImages/STEM.png`` and ``ImageSets/Main``.

    Rectangles are rounded to whole pixels, the first of which is 1, both ends included;
    a frame without boxes has its file too. What a VOC file said of pose, truncation,
    difficulty and occlusion is given back; else a box that the image's border cuts is
    truncated. Boxes to ignore are difficult, which VOC's scoring leaves out.

    References
    ----------
    .. [1] Everingham and Winn, "The PASCAL VOC2012 development kit", section 7,
       http://host.robots.ox.ac.uk/pascal/VOC/voc2012/htmldoc/
    """

    traits: ClassVar[Traits] = Traits("voc", keys=True, flat=True)

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._parts = {part: desk.spool() for part in PARTS}

    def image(self, out: OutFrame) -> str:
        """The name of a frame's image in the export."""
        return f"JPEGImages/{out.stem}{out.suffix}"

    def labels(self, band: str, out: OutFrame) -> None:
        """One XML file."""
        text = "\n".join(_lines(out)) + "\n"
        content = text.encode("utf-8", "replace")
        self._desk.sink(f"{band or 'Annotations'}/{out.stem}.xml", [content])
        if not band:
            self._parts[out.part].write(f"{out.stem}\n".encode())

    def finish(self) -> None:
        """Which frames are for training, and which classes there are."""
        for part, spool in self._parts.items():
            self._desk.sink(f"ImageSets/Main/{part}.txt", spool.pieces())
        self._desk.sink("labelmap.txt", [_label_map(self._desk.head.classes)])


def whole_pixels(
    xyxy: tuple[float, float, float, float], wh: tuple[int, int]
) -> list[int]:
    """``xmin ymin xmax ymax``: the nearest whole pixels, from 1, both ends included.

    There is at least one. The last pixel of the image is its width and height, so
    nothing lies beyond.
    """
    low, high = [], []
    for axis, side in enumerate(wh):
        start, stop = (math.floor(xyxy[edge] + 0.5) for edge in (axis, axis + 2))
        if stop == start:
            # Too thin to have a pixel of its own: the one that its middle is in.
            start = min(math.floor((xyxy[axis] + xyxy[axis + 2]) / 2), side - 1)
            stop = start + 1
        low.append(start + 1)
        high.append(stop)
    return [*low, *high]


def _label_map(classes: Sequence[str]) -> bytes:
    """The classes as CVAT and Datumaro want them, which else know VOC's twenty."""
    lines = ["# label:color_rgb:parts:actions", *(f"{name}:::" for name in classes)]
    return "".join(f"{line}\n" for line in lines).encode("utf-8", "replace")


def _lines(out: OutFrame) -> Iterator[str]:
    width, height = out.frame.wh
    yield "<annotation>"
    yield "  <folder>JPEGImages</folder>"
    yield f"  {element('filename', f'{out.stem}{out.suffix}')}"
    yield "  <source><database>Unghost</database></source>"
    yield (
        f"  <size><width>{width}</width><height>{height}</height>"
        "<depth>3</depth></size>"
    )
    yield "  <segmented>0</segmented>"
    for one in out.boxes:
        yield from _object(one, out.frame.wh)
    yield "</annotation>"


def _object(one: OutBox, wh: tuple[int, int]) -> Iterator[str]:
    given = one.box.given
    flags = {
        "pose": given.get("pose", "Unspecified"),
        "truncated": given.get("truncated", int(one.is_cut)),
        "difficult": 1 if one.ignored else given.get("difficult", 0),
        "occluded": given.get("occluded", 0),
    }
    yield "  <object>"
    yield f"    {element('name', one.box.class_name)}"
    for key, value in flags.items():
        yield f"    {element(key, value)}"
    yield "    <bndbox>"
    keys = ("xmin", "ymin", "xmax", "ymax")
    for key, value in zip(keys, whole_pixels(one.xyxy, wh), strict=True):
        yield f"      {element(key, value)}"
    yield "    </bndbox>"
    yield "  </object>"
