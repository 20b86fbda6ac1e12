"""The list of all formats, and the functions that read and write any of them.

A new format is a module that declares its `Format`, and a line of `FORMATS` here. Its
name is repeated in these places, each of which a check compares with this list:

* ``unghost/wire/words.py``: `ExportFormat` if it can be exported, `FolderLayout` if it
  can be read.
* ``static/js/upload/dialog.js``, if it can be read: its name for people.
* ``tests/pins``, if it can be exported: a digest of each of its files.

The service puts `Format.title` and `Format.brief` into the OpenAPI document, from which
the page takes them, and ``make docs`` generates the tables of docs/formats.md. Other
sentences of README.md and docs/ that name formats must be updated by hand. The recipe
is in ARCHITECTURE.md.

A *layout* is the format in which a folder is read: the name of a format that can be
read, or ``auto`` to recognise it from the folder's files.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

from filter_core.errors import LayoutError
from filter_core.formats.carlasimu import CARLASIMU
from filter_core.formats.coco import COCO
from filter_core.formats.cvat import CVAT
from filter_core.formats.decisions import (
    DECISIONS_CSV,
    DECISIONS_JSONL,
    DECISIONS_PARQUET,
)
from filter_core.formats.export import (
    ExportError,
    ExportFrame,
    ExportHead,
    ExportOptions,
    Sink,
)
from filter_core.formats.format import Format, Source
from filter_core.formats.kitti import KITTI
from filter_core.formats.label_studio import LABEL_STUDIO
from filter_core.formats.manifest import MANIFEST
from filter_core.formats.pairs import PAIRS
from filter_core.formats.reading import FrameSet, ReadOptions
from filter_core.formats.tally import Counts
from filter_core.formats.voc import VOC
from filter_core.formats.yolo import YOLO
from filter_core.values import nearest

FORMATS: Final[Mapping[str, Format]] = {
    one.name: one
    for one in (
        YOLO,
        COCO,
        KITTI,
        VOC,
        CVAT,
        LABEL_STUDIO,
        MANIFEST,
        DECISIONS_JSONL,
        DECISIONS_CSV,
        DECISIONS_PARQUET,
        CARLASIMU,
        PAIRS,
    )
}
"""By name, in the order in which they are offered."""

EXPORT_FORMATS: Final = tuple(name for name, one in FORMATS.items() if one.write)
"""The formats that `write_export` can write."""

LAYOUTS: Final = ("auto", *(name for name, one in FORMATS.items() if one.read))
"""The formats that `read_source` can read, and ``auto``."""

_ASKED_FIRST: Final = (MANIFEST, KITTI, CARLASIMU, VOC)
"""The layouts that are tried first, in this order; the others follow as in `FORMATS`.

The first that is certain is taken.
"""

_IN_ORDER_OF_ASKING: Final = dict.fromkeys((*_ASKED_FIRST, *FORMATS.values()))


def read_source(
    source: Path, layout: str = "auto", options: ReadOptions | None = None
) -> FrameSet:
    """The frames of a folder or a file, in the order of their keys or lines.

    Parameters
    ----------
    source : Path
        A folder in a recognised layout, a ``.jsonl`` file, or COCO's ``.json`` file.
    layout : str
        One of `LAYOUTS`: the format to read it in.
    options : ReadOptions, optional

    Returns
    -------
    FrameSet

    Raises
    ------
    LayoutError
        Nothing there, no layout or several recognised, or no list of classes.
    """
    if not source.exists():
        raise LayoutError(f"{source.name}: expected a folder or a manifest, found none")
    name = detect_layout(source) if layout == "auto" else layout
    found = FORMATS.get(name)
    if found is None or found.read is None:
        raise LayoutError(
            f"unknown layout {name[:40]!r}; the nearest is {nearest(name, LAYOUTS)!r}"
        )
    return found.read(source, options or ReadOptions())


def detect_layout(source: Path) -> str:
    """The name of the one layout that a folder or a file has.

    Parameters
    ----------
    source : Path

    Returns
    -------
    str
        One of `LAYOUTS`.

    Raises
    ------
    LayoutError
        None or several; names what was looked for or found.
    """
    found = possible_layouts(source)
    if len(found) == 1:
        return found[0]
    if found:
        raise LayoutError(
            f"{source.name}: could be {' or '.join(found)}; name the layout"
        )
    *first, last = (one.recognised_by for one in _IN_ORDER_OF_ASKING if one.recognise)
    raise LayoutError(
        f"{source.name}: no layout recognised; expected {', '.join(first)}, or {last}"
    )


def possible_layouts(source: Path) -> tuple[str, ...]:
    """The names of the layouts that a folder or a file may have, the likeliest first.

    No format is tried after one that is certain.
    """
    asked = Source(source)
    found: list[str] = []
    otherwise: list[str] = []
    for one in _IN_ORDER_OF_ASKING:
        recognition = one.recognise(asked) if one.recognise else "none"
        if recognition == "otherwise":
            otherwise.append(one.name)
        elif recognition != "none":
            found.append(one.name)
        if recognition == "certain":
            break
    return tuple(found or otherwise[:1])


def write_export(
    name: str,
    frames: Iterable[ExportFrame],
    sink: Sink,
    head: ExportHead,
    options: ExportOptions,
) -> Counts:
    """Write frames in one of `EXPORT_FORMATS`.

    Parameters
    ----------
    name : str
    frames : iterable of ExportFrame
        Read once, one at a time.
    sink : callable
        Gets each file whole before the next begins; ``manifest.json`` last.
    head : ExportHead
    options : ExportOptions

    Returns
    -------
    dict
        The counts, as ``manifest.json`` has them.

    Raises
    ------
    ExportError
        As `format_of`; or a class that is not in the list, counts that do not add up.
    NotAvailable
        As `format_of`.
    """
    write = format_of(name, options).write
    assert write is not None, "format_of gives formats that can be written"
    return write(frames, sink, replace(head, format=name), options)


def format_of(name: str, options: ExportOptions) -> Format:
    """The format of this name, if it can be written with these options.

    Raises
    ------
    ExportError
        There is no such format, or it has no such option.
    NotAvailable
        It needs a library that is not installed.
    """
    if name not in EXPORT_FORMATS:
        raise ExportError(
            f"unknown format {name[:40]!r}; the nearest is "
            f"{nearest(name, EXPORT_FORMATS)!r}",
            pointer="/format",
        )
    found = FORMATS[name]
    for option in sorted(options.changed() - found.options):
        heeded = ", ".join(sorted(found.options)) or "none"
        raise ExportError(
            f"format {name!r} has no option {option!r}; it has {heeded}",
            pointer=f"/options/{option}",
        )
    if found.require is not None:
        found.require()
    return found
