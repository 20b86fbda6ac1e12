"""CVAT for images 1.1: one XML file for all images.

Files are not trusted, so they are read with defusedxml, image by image.

References
----------
.. [1] CVAT, "CVAT for image",
   https://docs.cvat.ai/docs/dataset_management/formats/format-cvat/
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Final

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import ParseError, iterparse

from filter_core.errors import LayoutError
from filter_core.formats.files import attributes, element, escaped, number_text
from filter_core.formats.format import (
    FOLDER_OPTIONS,
    LABEL_NEEDS,
    LABEL_OPTIONS,
    Format,
    Recognition,
    Source,
)
from filter_core.formats.reading import (
    FrameSet,
    FrameSource,
    Labelled,
    annotated,
    counted_notes,
    open_regular,
    opening_file,
    read_columns,
    relative_path,
    time_of,
)
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.splits import completed_parts
from filter_core.formats.streams import listed_frames, listing_files
from filter_core.formats.tables.patterns import FilePatterns
from filter_core.formats.writing import ExportContext, LabelBox, OutFrame, Traits
from filter_core.verdicts import DecidedBoxes

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

CVAT: Final = Format(
    name="cvat",
    title="CVAT for images 1.1",
    docs_row="`annotations.xml` with id, verdict and reason of each box as attributes",
    brief="XML for CVAT's images task",
    recognised_by="CVAT's .xml file",
    read_options=FOLDER_OPTIONS | {"classes"},
    needs=LABEL_NEEDS,
    options=LABEL_OPTIONS,
)

_HEAD: Final = 4096
"""Bytes by which a file is recognised."""


@CVAT.recogniser
def _recognise(source: Source) -> Recognition:
    return "certain" if _cvat_files(source.path, source.files) else "none"


def _cvat_files(root: Path, files: FilePatterns) -> list[Path]:
    return [path for path in files.glob(root, "*.xml") if _is_cvat(path)]


def _is_cvat(path: Path) -> bool:
    """Whether a file begins with CVAT's root element; never raises."""
    if path.suffix.lower() != ".xml":
        return False
    try:
        with open_regular(path) as file:
            head = file.read(_HEAD)
    except OSError:
        return False
    return b"<annotations>" in head and any(
        word in head for word in (b"<version>", b"<meta>", b"<image ")
    )


_MAX_ELEMENTS: Final = 500_000
"""Of one image."""

_OUTSIDE_IMAGES: Final = ("label", "track", "meta")


def _elements(path: Path) -> Iterator[Element]:
    """Images, declared labels, tracks and the head of a file, one by one."""
    try:
        with opening_file(path, "labels"), open_regular(path) as file:
            count = 0
            for event, node in iterparse(
                _WithoutNamespaces(file.read, path.name),
                ("start", "end"),
                forbid_dtd=True,
            ):
                if event == "start":
                    count += 1
                    if count > _MAX_ELEMENTS:
                        raise LayoutError(
                            f"{path.name}: at most {_MAX_ELEMENTS} elements of one "
                            "image are read"
                        )
                elif node.tag in ("image", *_OUTSIDE_IMAGES):
                    yield node
                    node.clear()
                    count = 0
    except ParseError as exc:
        raise LayoutError(f"{path.name}: cannot be read as XML: {exc}") from exc
    except DefusedXmlException as exc:
        raise LayoutError(
            f"{path.name}: XML with a DTD or entities is refused"
        ) from exc
    except (ValueError, LookupError) as exc:
        raise LayoutError(f"{path.name}: cannot be read as XML: {exc}") from exc


class _WithoutNamespaces:
    """Reads a file; refuses namespaces, which a parser puts before each name."""

    def __init__(self, read: Callable[[int], bytes], name: str) -> None:
        self._read, self._name, self._end = read, name, b""

    def read(self, size: int = -1, /) -> bytes:
        """The next bytes."""
        piece = self._read(size)
        # UTF-16 has a NUL beside each letter.
        text = (self._end + piece).replace(b"\0", b"")
        if b"xmlns" in text:
            raise LayoutError(f"{self._name}: expected no namespaces (xmlns)")
        self._end = text[-len(b"xmln") :]
        return piece


def _listed(paths: Sequence[Path]) -> tuple[dict[str, None], list[str]]:
    """The declared labels, and the paths of all images."""
    classes: dict[str, None] = {}
    names = []
    for path in paths:
        for node in _elements(path):
            if node.tag == "track":
                raise LayoutError(
                    f"{path.name}: expected CVAT for images 1.1, found tracks of CVAT "
                    "for video; export the task as CVAT for images"
                )
            if node.tag == "label":
                if name := node.findtext("name"):
                    classes[name] = None
            elif node.tag == "image":
                names.append(relative_path(node.attrib.get("name", ""))[0] or "?")
    return classes, names


@CVAT.reader
def read_cvat(root: Path, options: RecordingDescription) -> FrameSet:
    """The frames of files of CVAT for images, in their order.

    Of other shapes than boxes, outlines are read as the rectangles around them, and
    others are left out; both are counted. The part of an image (``subset``) is kept.
    Raises `LayoutError`: no such file, one that cannot be read, or one of CVAT for
    video.
    """
    paths = listing_files(root, options, _cvat_files, "an .xml file of CVAT for images")
    folder = root.parent if root.is_file() else root
    classes, names = _listed(paths)
    listed = listed_frames(
        folder, options, [(None, name) for name in names], "CVAT file"
    )
    reading = _Reading()

    def frames() -> Iterator[FrameSource]:
        reading.counts.clear()
        coming = iter(listed)
        for path in paths:
            labelled = Labelled()  # by a person, also if no head of the file names one
            for node in _elements(path):
                if node.tag == "meta":
                    labelled = _labelled(node)
                elif node.tag == "image":
                    frame = replace(next(coming), labelled=labelled)
                    read = partial(reading.annotation, node, path.name)
                    yield frame if frame.problem else annotated(frame, read)

    return replace(
        listed,
        layout="cvat",
        frames=frames,
        classes=tuple(options.classes or classes) or None,
        notes=lambda: (*listed.notes(), *counted_notes(reading.counts, _NOTES)),
        texts=lambda: paths,
    )


def _labelled(meta: Element) -> Labelled:
    """Whom a task was given to, or else who owns it, and when it was changed last."""
    people = (
        name.strip()
        for tag in ("assignee", "owner")
        for node in meta.iter(tag)
        if (name := node.findtext("username") or node.text or "").strip()
    )
    times = (
        time_of(node.text) for tag in ("updated", "dumped") for node in meta.iter(tag)
    )
    return Labelled(next(people, None), next(filter(None, times), None))


_OURS: Final = frozenset({"id", "verdict", "reason"})
"""The attributes that `CvatWriter` writes with each box."""

_OUTLINES: Final = ("polygon", "polyline")

_SIDE: Final = re.compile(r"\d{1,9}")
"""Pixels of an image's side."""

_OTHERS: Final = ("points", "mask", "ellipse", "cuboid", "skeleton", "tag")


@dataclass
class _Reading:
    """Reads images of a file, and counts what is no plain box."""

    counts: Counter[str] = field(default_factory=Counter)

    def annotation(self, image: Element, name: str) -> dict[str, object]:
        """The boxes of one image; `name` is that of the file."""
        at = f"{name}, image {image.attrib.get('name', '')[:80]!r}"
        boxes = [self._box(node, at) for node in image.iter("box")]
        for kind in _OUTLINES:
            boxes += [self._outline(node, at) for node in image.iter(kind)]
        self.counts["other"] += sum(1 for kind in _OTHERS for _ in image.iter(kind))
        annotation: dict[str, object] = {"boxes": boxes}
        sides = [image.attrib.get(key, "") for key in ("width", "height")]
        if all(_SIDE.fullmatch(side) and int(side) for side in sides):
            width, height = map(int, sides)
            annotation["camera"] = {"width": width, "height": height}
        if subset := image.attrib.get("subset"):
            annotation["split"] = subset
        return annotation

    def _box(self, node: Element, at: str) -> dict[str, object]:
        keys = ("xtl", "ytl", "xbr", "ybr", "rotation")
        words = [node.attrib.get(key, "" if key != "rotation" else "0") for key in keys]
        *corners, angle = read_columns(words, at)
        if angle:
            self.counts["rotated"] += 1
            # The rectangle around one that is turned about its centre, by degrees
            x_min, y_min, x_max, y_max = corners
            width, height = x_max - x_min, y_max - y_min
            cos, sin = (abs(of(math.radians(angle))) for of in (math.cos, math.sin))
            halves = (width * cos + height * sin) / 2, (width * sin + height * cos) / 2
            centre = (x_min + x_max) / 2, (y_min + y_max) / 2
            sides = list(zip(centre, halves, strict=True))
            corners = [
                *(c - half for c, half in sides),
                *(c + half for c, half in sides),
            ]
        return _described(node, corners, at)

    def _outline(self, node: Element, at: str) -> dict[str, object]:
        points = node.attrib.get("points", "").replace(",", ";").split(";")
        numbers = read_columns(points, at)
        if len(numbers) % 2:
            raise LayoutError(
                f"{at}: expected points as x,y;x,y..., found {len(numbers)} numbers"
            )
        self.counts["outline"] += 1
        xs, ys = numbers[::2], numbers[1::2]
        return _described(node, [min(xs), min(ys), max(xs), max(ys)], at)


_NOTES: Final = {
    "rotated": "{:,} rotated boxes were read as the rectangles around them",
    "outline": "{:,} outlines were read as the rectangles around them",
    "other": "{:,} points, masks, tags and other shapes were left out",
}


def _described(node: Element, xyxy: Sequence[float], at: str) -> dict[str, object]:
    """A box with what its element says; other attributes are kept as they are."""
    label = node.attrib.get("label", "")
    if not label:
        raise LayoutError(f"{at}: expected the label of a {node.tag}, found none")
    texts = {
        each.attrib.get("name", ""): each.text or "" for each in node.iter("attribute")
    }
    box: dict[str, object] = {"class": label, "xyxy": list(xyxy)}
    if texts.keys() >= _OURS:
        box["id"] = texts["id"]
        texts = {name: text for name, text in texts.items() if name not in _OURS}
    elif node.attrib.get("occluded") in ("0", "1"):
        box["occluded"] = int(node.attrib["occluded"])
    if texts:
        box["attributes"] = texts
    return box


@CVAT.label_writer
class CvatWriter:
    """Writes ``annotations.xml`` and ``images/STEM.png``.

    It is the file of a project, whose tasks are the parts. Corners are pixels from 0.
    Each box has the attributes ``id``, ``verdict`` and
    ``reason``; the head of the file declares them, so that a CVAT task can be made with
    the same labels. Where rejected boxes are exported too, they are marked as occluded.
    """

    traits: ClassVar[Traits] = Traits(
        image="images/{stem}{suffix}", needs_key_list=True
    )

    def __init__(self, context: ExportContext) -> None:
        self._context = context
        self._images = context.spool()  # a temporary file
        self._parts: dict[str, None] = {}

    def labels(self, band: str, out: OutFrame) -> None:
        """One image with its boxes.

        `band` is always empty: only some formats can be exported in bands of distance.
        """
        self._parts[out.part] = None
        width, height = out.frame.wh
        image = attributes(
            id=out.number,
            name=f"{out.stem}{out.suffix}",
            subset=out.part,
            width=width,
            height=height,
        )
        boxes = "".join(_box(box, out.frame.boxes) for box in out.boxes)
        text = f"  <image{image}>\n{boxes}  </image>\n"
        self._images.write(text.encode("utf-8", "replace"))

    def finish(self) -> None:
        """The file, now that all images are known."""
        self._context.sink("annotations.xml", self._pieces())

    def _pieces(self) -> Iterator[bytes]:
        yield b'<?xml version="1.0" encoding="utf-8"?>\n<annotations>\n'
        yield b"  <version>1.1</version>\n  <meta>\n    <project>\n      <tasks>\n"
        for part in completed_parts(self._parts):
            yield f"        <task>{element('subset', part)}</task>\n".encode()
        yield b"      </tasks>\n      <labels>\n"
        for name in self._context.head.classes:
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
            yield (
                f"        <label>{element('name', name)}"
                f"<attributes>{declared}</attributes></label>\n"
            ).encode("utf-8", "replace")
        yield b"      </labels>\n    </project>\n  </meta>\n"
        yield from self._images.pieces()
        yield b"</annotations>\n"


_VERDICT_VALUES: Final = "kept\nrejected\nunmeasured"


def _box(label_box: LabelBox, boxes: DecidedBoxes) -> str:
    verdict = boxes.effective_verdict(label_box.row)
    corners = zip(("xtl", "ytl", "xbr", "ybr"), label_box.xyxy, strict=True)
    box = attributes(
        label=boxes.class_name(label_box.row),
        source="auto",
        occluded=int(verdict == "rejected"),
        **{key: number_text(value, most=_DECIMALS) for key, value in corners},
        z_order=0,
    )
    details = {
        "id": boxes.ids[label_box.row],
        "verdict": verdict,
        "reason": boxes.reason_label(label_box.row),
    }
    lines = "".join(
        f"      <attribute{attributes(name=key)}>{escaped(value)}</attribute>\n"
        for key, value in details.items()
    )
    return f"    <box{box}>\n{lines}    </box>\n"


_DECIMALS: Final = 9
