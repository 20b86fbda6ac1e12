"""The list of all formats, and the functions that read and write any of them.

A new format is a module that declares its `Format`, a line of `FORMATS` here, and its
name in `unghost/wire/words.py` (that of a layout also in `LAYOUTS` of `recording.py`);
"Add a format" in ARCHITECTURE.md has the tests and documents, too. The service, the
command line and the page take everything else from its `Format`.

A *layout* is the format in which a folder is read: the name of a format that can be
read, or ``auto`` to recognise it from the folder's files.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final
from zipfile import is_zipfile

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
    changed_options,
)
from filter_core.formats.format import Format, Source
from filter_core.formats.kitti import KITTI
from filter_core.formats.label_studio import LABEL_STUDIO
from filter_core.formats.labels import described_labels
from filter_core.formats.manifest import MANIFEST
from filter_core.formats.outside import check_links, files_inside
from filter_core.formats.pairs import PAIRS
from filter_core.formats.reading import (
    MANIFEST_NAME,
    RECORDING_NAME,
    FrameSet,
    manifests_below,
    name_of,
)
from filter_core.formats.recorders import recorder_of
from filter_core.formats.recording import (
    LAYOUTS,
    READER_KEYS,
    RecordingDescription,
    describe,
    place_in_file,
)
from filter_core.formats.table import TABLE
from filter_core.formats.tally import Counts
from filter_core.formats.voc import VOC
from filter_core.formats.yolo import YOLO, NoClassList, lacking_class_list
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
        TABLE,
        PAIRS,
    )
}
"""By name, in the order in which they are offered."""

EXPORT_FORMATS: Final = tuple(name for name, one in FORMATS.items() if one.write)
"""The formats that `write_export` can write."""

UNUSED_OPTION: Final = "unused_option"
"""Code of the error about an option that a layout does not have."""

_TRIED_FIRST: Final = (MANIFEST, KITTI, CARLASIMU, VOC)
"""Layouts that are tried before the others, which follow as in `FORMATS`."""

_IN_ORDER_OF_TRIAL: Final = dict.fromkeys((*_TRIED_FIRST, *FORMATS.values()))


def read_source(
    source: Path,
    layout: str = "auto",
    options: RecordingDescription | None = None,
    *,
    recognise: bool = True,
) -> FrameSet:
    """The frames of a folder or a file, in the order of their keys or lines.

    Parameters
    ----------
    source : Path
        A folder in a recognised layout, a ``.jsonl`` file, or COCO's ``.json`` file.
    layout : str
        One of `LAYOUTS`: the format to read it in; ``auto``: that of the description,
        else the one that the files show.
    options : RecordingDescription, optional
        Default: that of ``recording.yaml`` beside the data, or of its recorder
        (`describe_source`).
    recognise : bool
        Whether boxes in another unit or notation than the layout's are refused.

    Returns
    -------
    FrameSet

    Raises
    ------
    LayoutError
        Nothing there, no layout or several recognised, an option that the layout does
        not have, no list of classes, files outside the folder that the options do
        not allow, boxes in another unit or notation than the layout's
        (`described_labels`), or a fault in ``recording.yaml``.
    """
    if not source.exists():
        raise LayoutError(
            f"{name_of(source)}: expected a folder or a manifest, found none"
        )
    options = describe_source(source) if options is None else options
    layout = options.own_layout if layout == "auto" else layout
    name = detect_layout(source) if layout == "auto" else layout
    found = FORMATS.get(name)
    if found is None or found.read is None:
        raise LayoutError(
            f"unknown layout {name[:40]!r}; the nearest is {nearest(name, LAYOUTS)!r}"
        )
    for option in sorted(READER_KEYS & set(options.changed) - found.read_options):
        place = place_in_file(option)
        allowed = ", ".join(sorted(found.read_options))
        raise LayoutError(
            f"layout {name!r} has no option {option!r} ({place} of a description); it "
            f"has {allowed}",
            code=UNUSED_OPTION,
        )
    if source.is_dir() and found is not MANIFEST:  # which checks each file it names
        check_links(source, options)
    frames = found.read(source, options)
    if (source.is_file() or options.files.roles) and found is not MANIFEST:
        frames = files_inside(frames, source, options)
    if options.recorder and found.name == options.layout:
        frames = _with_note(frames, f"recognised as a recording of {options.recorder}")
    # CarlaSimu's own labels are taken as its published code takes them.
    recognise = recognise and found is not CARLASIMU
    return described_labels(frames, options, recognise=recognise)


def _with_note(frames: FrameSet, note: str) -> FrameSet:
    notes = frames.notes
    return replace(frames, notes=lambda: (note, *notes()))


def describe_source(
    source: Path,
    file: Path | None = None,
    options: Mapping[str, object] | None = None,
) -> RecordingDescription:
    """The description of a recording, as `describe` makes it, or that of its recorder.

    A folder without a description, whose layout is neither named nor recognised, may be
    a recording of a public recorder, whose description came with the product.

    Raises
    ------
    LayoutError, ConfigError
        As `describe`.
    """
    description = describe(source, file, options)
    is_described = file or (source / RECORDING_NAME).is_file()
    if is_described or description.own_layout != "auto" or not source.is_dir():
        return description
    recorder = recorder_of(source)
    if recorder is None:
        return description
    found, fallbacks = _recognised(source)
    if found or MANIFEST.name in fallbacks:
        return description
    values = {**recorder.values, "recorder": recorder.name}
    return describe(source, options={**values, **(options or {})})


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
            f"{name_of(source)}: could be {' or '.join(found)}; name the layout"
        )
    if several := manifests_below(source):
        raise LayoutError(
            f"{name_of(source)}: expected one {MANIFEST_NAME}, found {len(several)}; "
            f"give the folder of one of them, such as {Path(several[0]).parent}"
        )
    if is_zipfile(source):
        raise LayoutError(
            f"{name_of(source)}: expected a folder or a manifest, found a ZIP archive; "
            "unpack it first"
        )
    *first, last = (one.recognised_by for one in _IN_ORDER_OF_TRIAL if one.recognise)
    lacking = lacking_class_list(Source(source))
    problem = f"no layout recognised; expected {', '.join(first)}, or {last}"
    if lacking:
        raise NoClassList(f"{name_of(source)}: {problem}; {lacking}")
    raise LayoutError(f"{name_of(source)}: {problem}")


def possible_layouts(source: Path) -> tuple[str, ...]:
    """The names of the layouts that a folder or a file may have, the likeliest first.

    No format is tried after one that is certain.
    """
    found, fallbacks = _recognised(source)
    return tuple(found or fallbacks[:1])


def _recognised(source: Path) -> tuple[list[str], list[str]]:
    """The layouts that a source may have, and those that it can be read in at least."""
    examined = Source(source)
    found: list[str] = []
    fallbacks: list[str] = []
    for one in _IN_ORDER_OF_TRIAL:
        recognition = one.recognise(examined) if one.recognise else "none"
        if recognition == "fallback":
            fallbacks.append(one.name)
        elif recognition != "none":
            found.append(one.name)
        if recognition == "certain":
            break
    return found, fallbacks


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
    assert write is not None, "format_of returned a format that cannot be written"
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
    for option in sorted(changed_options(options) - found.options):
        allowed = ", ".join(sorted(found.options)) or "none"
        raise ExportError(
            f"format {name!r} has no option {option!r}; it has {allowed}",
            pointer=f"/options/{option}",
        )
    if found.require is not None:
        found.require()
    return found
