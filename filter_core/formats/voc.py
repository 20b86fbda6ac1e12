"""Pascal VOC: one XML file per image, with rectangles in whole pixels from 1.

Files are not trusted, so they are read with defusedxml, and their depth and number
of elements have limits.

References
----------
.. [1] Everingham and Winn, "The PASCAL VOC2012 development kit", section 7,
   http://host.robots.ox.ac.uk/pascal/VOC/voc2012/htmldoc/
"""

from __future__ import annotations

import html
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, ClassVar, Final

from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import DefusedXMLParser, ParseError

from filter_core.errors import LayoutError
from filter_core.formats.files import element
from filter_core.formats.format import (
    FOLDER_OPTIONS,
    LABEL_NEEDS,
    LABEL_OPTIONS,
    Format,
    Recognition,
    Source,
)
from filter_core.formats.matching import FrameFileNames, frame_of, match, with_keys
from filter_core.formats.reading import (
    FrameSet,
    annotated,
    band_folders,
    last_name,
    read_label_bytes,
)
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.same import BoxSpan, OwnLabels, OwnReading, Rectangles
from filter_core.formats.streams import Streams
from filter_core.formats.writing import RECTANGLE_KEYS, ExportContext, OutFrame, Traits

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

VOC: Final = Format(
    name="voc",
    title="Pascal VOC",
    docs_row=(
        "rectangles in whole pixels from 1, both ends included: `Annotations/`, "
        "`JPEGImages/`, `ImageSets/Main/`"
    ),
    brief="one XML file per frame",
    recognised_by="Pascal VOC's .xml files",
    read_options=FOLDER_OPTIONS | {"origin"},
    needs=LABEL_NEEDS,
    options=LABEL_OPTIONS | {"bands", "rejected"},
)


@VOC.recogniser
def _recognise(source: Source) -> Recognition:
    has_labels = any(name.lower().endswith(".xml") for name in source.label_files)
    return "possible" if has_labels else "none"


@VOC.reader
def read_voc_folder(root: Path, options: RecordingDescription) -> FrameSet:
    """The frames of a VOC folder; a file that is not VOC is that frame's problem.

    Whether the first pixel is 0 or 1 is decided once, from all files
    (`_shown_origin`), if it is not said. An image that is not called like its label is
    the one that ``<folder>`` and ``<filename>`` of the label name.
    """
    labels = options.labels or root
    skip = band_folders(root)
    names = list(options.files.walk(root, labels, (".xml",), skip))
    streams = Streams(root, options, skip=skip)
    frames, unmatched = match(
        names,
        streams.images,
        image_named=lambda label: _named_image(_content(labels, label)),
    )
    frames, left_over = streams.complete(frames, "label file")
    named = with_keys(root, frames)
    if options.origin == "auto":
        origin, why = _shown_origin(labels, names)
    else:
        origin, why = int(options.origin), ()
    notes = (*streams.notes, *why)
    read = partial(_annotation, labels, origin)
    return FrameSet(
        layout="voc",
        frames=lambda: (
            annotated(frame_of(frame, root, labels), partial(read, frame))
            for frame in named
        ),
        count=len(frames),
        unmatched=(*unmatched, *left_over),
        notes=lambda: notes,
        streams=streams.facts,
        texts=lambda: (labels / frame.label for frame in named),
    )


def _content(labels: Path, name: str) -> bytes:
    """A label file's text with one byte for each letter; empty if it cannot be read."""
    try:
        # UTF-16 has a NUL beside each letter of ASCII.
        return read_label_bytes(labels / name, name).replace(b"\0", b"")
    except LayoutError:
        return b""  # its frame will have this problem


_CORNER: Final = re.compile(rb"<[xy](?:min|max)>\s{0,20}([-+.\deE]{1,40})")


_STRAY_ZEROS: Final = 1 / 20
"""Share of boxes with a corner at 0, at most, that may be mistakes."""


def _shown_origin(labels: Path, names: Iterable[str]) -> tuple[int, tuple[str, ...]]:
    """The number of the first pixel, as all rectangles show it, and why, in a note.

    Pascal VOC's own files count whole pixels from 1, so no corner is 0. Scripts that
    write pixel coordinates as they have them give themselves away by a 0 in more than
    one box of twenty, or by fractions in most; a few say nothing about the others.
    """
    boxes = zeros = fractional = 0
    first_zero = ""
    for name in names:
        words = _CORNER.findall(_content(labels, name))
        try:
            numbers = list(map(float, words))
        except ValueError:
            continue  # its frame will have this problem
        boxes += len(numbers) // len(_CORNERS)
        places = range(0, len(numbers), len(_CORNERS))
        rectangles = [numbers[place : place + len(_CORNERS)] for place in places]
        with_zero = sum(0.0 in rectangle for rectangle in rectangles)
        zeros += with_zero
        first_zero = first_zero or (name if with_zero else "")
        if b"." in b"".join(words):
            are_whole = (all(map(float.is_integer, each)) for each in rectangles)
            fractional += sum(not is_whole for is_whole in are_whole)
    if not boxes:
        return 1, ()
    origin = 0
    if zeros > _STRAY_ZEROS * boxes:
        why = f"from 0: {zeros} of {boxes} boxes have a corner at 0"
    elif 2 * fractional > boxes:
        why = f"from 0: {fractional} of {boxes} boxes have fractions"
    else:
        origin = 1
        corners = "no corner is 0"
        if zeros:
            corners = (
                f"only {zeros} of {boxes} boxes have a corner at 0, the first in "
                f"{first_zero}"
            )
        why = f"from 1, both ends included: {corners}"
    return origin, (
        f"pixels are counted {why}; if that is wrong, `boxes: {{origin: "
        f"{1 - origin}}}` in recording.yaml says so",
    )


def _named_image(content: bytes) -> str | None:
    """The path of the image that a label file names, if it is read as any text."""
    names = [
        re.search(rb"<%s>([^<]{1,500})</" % key, content)
        for key in (b"folder", b"filename")
    ]
    folder, name = (
        html.unescape(m[1].decode("utf-8", "replace")) if m else "" for m in names
    )
    if not name.strip():
        return None
    return f"{folder.strip()}/{name.strip()}".replace("\\", "/").lstrip("/")


def _annotation(labels: Path, origin: int, files: FrameFileNames) -> dict[str, object]:
    content = read_label_bytes(labels / files.label, files.label)
    return read_voc(content, files.label, origin)


def read_voc(content: bytes, name: str, origin: int = 1) -> dict[str, object]:
    """The annotation in one VOC file; `name` is the name of the file in errors.

    If the first pixel is number 1 (`origin`), as in Pascal VOC's own files, corners are
    inclusive, and become half-open; if it is 0, they are taken as they are. VOC's pose,
    truncation, difficulty and occlusion are kept with the box. Raises `LayoutError`:
    not XML, XML with a DTD, with entities or beyond the limits, or not VOC; names file,
    line, what was expected and what was found.
    """
    tree = _parse(content, name)
    if tree.root.tag != "annotation":
        raise tree.error(tree.root, "<annotation>", f"<{tree.root.tag[:40]}>")
    objects = list(tree.root.iter("object"))
    corners = [_corners(tree, node) for node in objects]
    boxes = [
        {
            "class": _text(tree, node, "name"),
            "xyxy": [x_min - origin, y_min - origin, x_max, y_max],
            **{
                key: int(text) if text in ("0", "1") else text
                for key in _KEPT
                if (text := (node.findtext(key) or "").strip())
            },
        }
        for node, (x_min, y_min, x_max, y_max) in zip(objects, corners, strict=True)
    ]
    annotation: dict[str, object] = {"boxes": boxes}
    size = tree.root.find("size")
    if size is not None:
        width, height = (_side(tree, size, key) for key in ("width", "height"))
        # Some tools write zeros where they do not know; that is no size.
        if width and height:
            annotation["camera"] = {"width": width, "height": height}
    return annotation


@VOC.spans
def _spans(file: BinaryIO) -> Iterator[BoxSpan]:
    """The objects of a file, each with the space before it."""
    content = file.read()
    tree = _parse(content, "labels")
    for place, node in enumerate(tree.root.iter("object")):
        start, end = tree.tags[node]
        # UTF-16 has a NUL beside each sign, and is cut from sign to sign.
        end = content.index(b">", end) + (
            2 if content[start:].startswith(b"<\0") else 1
        )
        space = len(content[:start].rstrip(b" \t\r\n"))
        if content[:space].endswith(b">"):
            start = space
        yield BoxSpan(place, start, end)


@dataclass(frozen=True)
class _Tree:
    """A parsed file, with the places of its elements.

    They are the line that each one starts on, and the bytes at which its first and last
    tag begin.
    """

    name: str
    root: Element
    lines: dict[Element, int]
    tags: dict[Element, tuple[int, int]]

    def error(self, at: Element, expected: str, found: str) -> LayoutError:
        return LayoutError(
            f"{self.name}, line {self.lines[at]}: expected {expected}, found {found}"
        )


_MAX_DEPTH: Final = 32

_MAX_ELEMENTS: Final = 500_000


_MAX_NAMESPACE: Final = 100

_LONG_NAMESPACE: Final = re.compile(
    rb"""xmlns(?!(?::[^\s="'<>]{1,%d})?\s{0,9}=\s{0,9}("[^"]{0,%d}"|'[^']{0,%d}'))"""
    % ((_MAX_NAMESPACE,) * 3)
)
"""``xmlns`` without a short namespace behind it; also in a comment or a text."""


def _parse(content: bytes, name: str) -> _Tree:
    # The parser puts a name's namespace before it: 8 MB before each of 500,000 names.
    # UTF-16 has a NUL beside each letter; other encodings have the letters of ASCII.
    if _LONG_NAMESPACE.search(content.replace(b"\0", b"")):
        raise LayoutError(
            f"{name}: expected a namespace of at most {_MAX_NAMESPACE} characters "
            "after each `xmlns`, also in comments and texts"
        )
    parser = _LineParser()
    try:
        parser.feed(content)
        root = parser.close()
    except ParseError as exc:
        line, column = exc.position
        # The text ends in the place, too, with columns counted from 0.
        problem = str(exc).removesuffix(f": line {line}, column {column}")
        raise LayoutError(
            f"{name}, line {line}, column {column + 1}: cannot be read as XML: "
            f"{problem}"
        ) from exc
    except DefusedXmlException as exc:
        raise LayoutError(f"{name}: XML with a DTD or entities is refused") from exc
    except (ValueError, LookupError) as exc:
        raise LayoutError(f"{name}: cannot be read as XML: {exc}") from exc
    return _Tree(name, root, parser.lines, parser.tags)


class _TooMuchXml(ValueError):
    """XML that is deeper, or has more elements, than any file of boxes."""


class _LineParser(DefusedXMLParser):
    """Notes the line of each element, which errors are to name, and its bytes."""

    def __init__(self) -> None:
        super().__init__(forbid_dtd=True)
        self.lines: dict[Element, int] = {}
        self.tags: dict[Element, tuple[int, int]] = {}
        self._depth = 0

    def _start(self, tag: str, attributes: list[str]) -> Element:
        self._depth += 1
        if self._depth > _MAX_DEPTH or len(self.lines) == _MAX_ELEMENTS:
            raise _TooMuchXml(
                f"at most {_MAX_ELEMENTS} elements in {_MAX_DEPTH} levels are read"
            )
        started: Element = super()._start(tag, attributes)  # type: ignore[misc]  # stubs
        self.lines[started] = self.parser.CurrentLineNumber
        self.tags[started] = self.parser.CurrentByteIndex, -1
        return started

    def _end(self, tag: str) -> Element:
        self._depth -= 1
        ended: Element = super()._end(tag)  # type: ignore[misc]  # stubs
        self.tags[ended] = self.tags[ended][0], self.parser.CurrentByteIndex
        return ended


_CORNERS: Final = ("xmin", "ymin", "xmax", "ymax")


def _corners(tree: _Tree, node: Element) -> list[float]:
    rectangle = node.find("bndbox")
    if rectangle is None:
        raise tree.error(node, "<bndbox> in the object", "none")
    return [_number(tree, rectangle, key) for key in _CORNERS]


def _number(tree: _Tree, parent: Element, key: str) -> float:
    text = _text(tree, parent, key)
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        child = parent.find(key)
        at = parent if child is None else child
        raise tree.error(at, f"a finite number in <{key}>", repr(text[:40]))
    return number


def _text(tree: _Tree, parent: Element, key: str) -> str:
    text = (parent.findtext(key) or "").strip()
    if not text:
        raise tree.error(parent, f"<{key}> in <{parent.tag}>", "nothing")
    return text


_KEPT: Final = ("pose", "truncated", "difficult", "occluded")

_MAX_SIDE: Final = 1 << 16


def _side(tree: _Tree, size: Element, key: str) -> int:
    number = _number(tree, size, key)
    if not 0 <= number <= _MAX_SIDE or number != int(number):
        raise tree.error(size, f"a whole <{key}> up to {_MAX_SIDE}", f"{number:g}")
    return int(number)


def _rectangles(own: OwnLabels) -> Iterator[Rectangles]:
    """Of each object what it may be: pixels may be counted from 1 or from 0."""
    tree = _parse(own.content, own.file)
    for node in tree.root.iter("object"):
        x_min, y_min, x_max, y_max = _corners(tree, node)
        yield {
            "xyxy": [
                [x_min - origin, y_min - origin, x_max, y_max] for origin in (1, 0)
            ]
        }


def _own(out: OutFrame) -> bytes | None:
    """The frame's own file without the objects that are not written.

    Its image gets the name that it has in the export. None if it names other classes.
    """
    if out.own is None or any(box.ignored for box in out.boxes):
        return None
    tree = _parse(out.own.content, out.own.file)
    objects = tree.root.iter("object")
    names = [(node.findtext("name") or "").strip() for node in objects]
    is_own = all(
        names[box.row] == out.frame.boxes.class_name(box.row) for box in out.boxes
    )
    content = out.own.with_rows({box.row for box in out.boxes}) if is_own else None
    image = (tree.root.findtext("filename") or "").strip().replace("\\", "/")
    name = f"{out.stem}{out.suffix}"
    # Without a name of an image it is that of the file.
    if content is None or last_name(image) in ("", name):
        return content
    there = f"<filename>{html.escape(name, quote=False)}</filename>".encode()
    named, count = _FILE_NAME.subn(lambda _: there, content, count=1)
    return named if count else None


_FILE_NAME: Final = re.compile(rb"<filename>[^<]*</filename>")


@VOC.label_writer
class VocWriter:
    """Writes ``Annotations/STEM.xml``, ``JPEGImages/STEM.png`` and ``ImageSets/Main``.

    Rectangles are rounded to whole pixels, the first of which is 1, both ends included;
    a frame without boxes has its file too. Pose, truncation, difficulty and occlusion
    from a VOC file are written again; otherwise a box that is cut by the image's border
    is truncated. Boxes to ignore are difficult, which VOC's scoring leaves out.
    """

    traits: ClassVar[Traits] = Traits(
        image="JPEGImages/{stem}{suffix}",
        needs_key_list=True,
        needs_flat_names=True,
        box_keys=RECTANGLE_KEYS | frozenset(_KEPT),
        own=OwnReading(_spans, _rectangles),
    )

    def __init__(self, context: ExportContext) -> None:
        self._context = context

    def labels(self, band: str, out: OutFrame) -> None:
        """One XML file: of a distance band, or of all boxes if `band` is empty."""
        content = _own(out)
        if content is not None:
            self._context.note_own(band)
        else:
            content = ("\n".join(_lines(out)) + "\n").encode("utf-8", "replace")
        self._context.sink(f"{band or 'Annotations'}/{out.stem}.xml", [content])
        if not band:
            self._context.list_frame(out.part, out.stem)

    def finish(self) -> None:
        """Which frames are for training, and which classes there are."""
        self._context.write_lists("ImageSets/Main")
        # For CVAT and Datumaro, which otherwise know VOC's own twenty classes
        classes = (f"{name}:::\n" for name in self._context.head.classes)
        text = "".join(["# label:color_rgb:parts:actions\n", *classes])
        self._context.sink("labelmap.txt", [text.encode("utf-8", "replace")])


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
    for box in out.boxes:
        frame = out.frame
        raw = frame.given.boxes[box.row]
        pose = raw.get("pose")
        flags = {
            "pose": pose if isinstance(pose, str) else "Unspecified",
            "truncated": _flag(raw.get("truncated"), box.is_cut),
            "difficult": _flag(
                None if box.ignored else raw.get("difficult"), box.ignored
            ),
            "occluded": _flag(raw.get("occluded"), False),
        }
        yield "  <object>"
        yield f"    {element('name', frame.boxes.class_name(box.row))}"
        for key, value in flags.items():
            yield f"    {element(key, value)}"
        yield "    <bndbox>"
        for key, value in zip(_CORNERS, whole_pixels(box.xyxy, frame.wh), strict=True):
            yield f"      {element(key, value)}"
        yield "    </bndbox>"
        yield "  </object>"
    yield "</annotation>"


def _flag(value: object, usual: bool) -> int:
    """0 or 1, as VOC writes flags; the usual value in place of anything else."""
    return int(value) if value in (0, 1) and isinstance(value, int) else int(usual)


def whole_pixels(xyxy: Sequence[float], wh: tuple[int, int]) -> list[int]:
    """``xmin ymin xmax ymax``: the nearest whole pixels, from 1, both ends included.

    `xyxy` is a rectangle in px inside an image of `wh` (width, height). It has at least
    one pixel. The last pixel of the image has its width and height as numbers, so no
    corner lies beyond it.
    """
    low, high = [], []
    for axis, side in enumerate(wh):
        start, stop = (math.floor(xyxy[edge] + 0.5) for edge in (axis, axis + 2))
        if stop == start:
            # Rounding left no pixel: take the one that the middle is in.
            start = min(math.floor((xyxy[axis] + xyxy[axis + 2]) / 2), side - 1)
            stop = start + 1
        low.append(start + 1)
        high.append(stop)
    return [*low, *high]
