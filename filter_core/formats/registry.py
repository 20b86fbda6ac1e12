"""The list of all formats, and the functions that read and write any of them.

A new format is a module that declares its `Format`, a line of `FORMATS` here, and its
name in `unghost/wire/words.py` (that of a layout also in `LAYOUTS` of `recording.py`);
"Add a format" in ARCHITECTURE.md has the tests and documents, too. The service, the
command line and the page take everything else from its `Format`.

A *layout* is the format in which a folder is read: the name of a format that can be
read, or ``auto`` to recognise it from the folder's files.

Installed packages add formats that can be read (`plugins`). They are imported once,
when a folder is recognised or read that may be in one of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Final, NamedTuple
from zipfile import is_zipfile

from filter_core.errors import FilterError, LayoutError
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
    non_default_options,
)
from filter_core.formats.format import Format, Source
from filter_core.formats.kitti import KITTI
from filter_core.formats.label_studio import LABEL_STUDIO
from filter_core.formats.labels import described_labels, with_maps
from filter_core.formats.manifest import MANIFEST
from filter_core.formats.nuscenes import NUSCENES
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
    package_of,
    place_in_file,
    plugin_entries,
)
from filter_core.formats.splits import with_splits
from filter_core.formats.streams.outside import check_links, files_inside
from filter_core.formats.table import TABLE
from filter_core.formats.tables.patterns import LABELS
from filter_core.formats.tally import Counts
from filter_core.formats.voc import VOC
from filter_core.formats.yolo import YOLO, NoClassList, lacking_class_list
from filter_core.values import nearest

FORMATS: Final[Mapping[str, Format]] = {
    file_format.name: file_format
    for file_format in (
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
        NUSCENES,
        TABLE,
        PAIRS,
    )
}
"""By name, in the order in which they are offered."""

EXPORT_FORMATS: Final = tuple(
    name for name, file_format in FORMATS.items() if file_format.write
)
"""The formats that `write_export` can write."""

UNUSED_OPTION: Final = "unused_option"
"""Code of the error about an option that a layout does not have."""

_TRIED_FIRST: Final = (
    *(LABEL_STUDIO, CVAT, DECISIONS_JSONL),
    *(MANIFEST, KITTI, CARLASIMU, NUSCENES, VOC),
)
"""Layouts that are tried before the others, which follow as in `FORMATS`."""

_IN_ORDER_OF_TRIAL: Final = dict.fromkeys((*_TRIED_FIRST, *FORMATS.values()))
"""Those of plug-ins follow."""


class Plugins(NamedTuple):
    """What installed packages add.

    Attributes
    ----------
    formats : mapping of str to Format
        By name.
    packages : mapping of str to str
        The package of each, with its version.
    faults : tuple of (str, str)
        Names of plug-ins that cannot be used, each with a sentence that says why.
    """

    formats: Mapping[str, Format]
    packages: Mapping[str, str]
    faults: tuple[tuple[str, str], ...]


@cache
def plugins() -> Plugins:
    """The formats of installed packages, imported when this is called first."""
    formats: dict[str, Format] = {}
    packages: dict[str, str] = {}
    faults = []
    for entry in plugin_entries():
        package = package_of(entry)
        owner = "Unghost" if entry.name in FORMATS else packages.get(entry.name)
        try:
            if owner is not None:
                raise LayoutError(f"{owner} has a format of this name")
            plugin = declared_format(entry.load())
            if plugin.name != entry.name:
                raise LayoutError(
                    f"its format is called {plugin.name!r}; expected the name of the "
                    "entry point"
                )
            if plugin.read is None or plugin.recognise is None:
                raise LayoutError("its format lacks a reader or a recogniser")
        except Exception as exc:  # of a foreign module, which may do anything
            why = _as_words(exc)
            faults.append(
                (
                    entry.name,
                    f"the plug-in {entry.name!r} of the package {package} is not "
                    f"used: {why}",
                )
            )
        else:
            formats[plugin.name], packages[plugin.name] = plugin, package
    return Plugins(formats, packages, tuple(faults))


def declared_format(declared: object) -> Format:
    """The format that an entry point names: a `Format`, or the only one of a module.

    Raises `LayoutError`: there is none, or several.
    """
    if isinstance(declared, ModuleType):
        named = vars(declared).values()
        formats = list(
            dict.fromkeys(value for value in named if isinstance(value, Format))
        )
        if len(formats) == 1:
            return formats[0]
        raise LayoutError(
            f"{declared.__name__}: expected one Format, found {len(formats)}"
            + ("; MODULE:NAME names one of them" if formats else "")
        )
    if not isinstance(declared, Format):
        raise LayoutError(f"expected a Format, found {type(declared).__name__}")
    return declared


def layout_format(name: str) -> Format:
    """The format of this name that a folder can be read in, also that of a plug-in.

    Raises `LayoutError`: there is none, or its plug-in cannot be used.
    """
    layout = FORMATS.get(name) or plugins().formats.get(name)
    if layout is not None and layout.read is not None:
        return layout
    for plugin, fault in plugins().faults:
        if plugin == name:
            raise LayoutError(fault)
    names = (*LAYOUTS, *plugins().formats)
    raise LayoutError(
        f"unknown layout {name[:40]!r}; the nearest is {nearest(name, names)!r}"
    )


@contextmanager
def _blaming_plugin(file_format: Format) -> Iterator[None]:
    """Makes an error that a plug-in should not raise one that names its package."""
    try:
        yield
    except FilterError:
        raise
    except Exception as exc:
        if file_format.name in FORMATS:
            raise
        package = plugins().packages[file_format.name]
        raise LayoutError(
            f"the plug-in {file_format.name!r} of the package {package} fails with "
            f"{_as_words(exc)}; `layout` in recording.yaml names another layout"
        ) from exc


def _as_words(error: Exception) -> str:
    if isinstance(error, FilterError):
        return error.detail
    return f"{type(error).__name__}: {error}"


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
        One of `LAYOUTS`, or the name of a plug-in: the format to read it in; ``auto``:
        that of the description, else the one that the files show.
    options : RecordingDescription, optional
        Default: that of ``recording.yaml`` beside the data, or of its recorder
        (`describe_source`).
    recognise : bool
        Whether boxes in another unit or notation than the layout's are refused.

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
    name = detect_layout(source, options) if layout == "auto" else layout
    source_format = layout_format(name)
    _check_options(options, source_format)
    # A manifest's reader checks each file that it names.
    if source.is_dir() and source_format is not MANIFEST:
        check_links(source, options)
    with _blaming_plugin(source_format):
        assert source_format.read is not None, (
            "layout_format returned one that cannot be read"
        )
        frames = replace(source_format.read(source, options), layout=source_format.name)
    if (source.is_file() or options.files.roles) and source_format is not MANIFEST:
        frames = files_inside(frames, source, options)
    if options.recorder and source_format.name == options.layout:
        frames = _with_note(frames, f"recognised as a recording of {options.recorder}")
    if options.own_layout == "auto":
        for _, fault in plugins().faults:
            frames = _with_note(frames, fault)
    # CarlaSimu's own labels are taken as its published code takes them.
    recognise = recognise and source_format is not CARLASIMU
    described = described_labels(frames, options, recognise=recognise)
    located = with_maps(described, options, source)
    return with_splits(located, source, options.split)


def _check_options(options: RecordingDescription, layout: Format) -> None:
    """Refuse options that a format does not have."""
    for option in sorted(READER_KEYS & set(options.changed) - layout.read_options):
        place = place_in_file(option)
        allowed = ", ".join(sorted(layout.read_options))
        raise LayoutError(
            f"layout {layout.name!r} has no option {option!r} ({place} of a "
            f"description); it has {allowed}",
            code=UNUSED_OPTION,
        )
    if LABELS in options.files.roles and "key" not in layout.read_options:
        raise LayoutError(
            f"layout {layout.name!r} has no pattern of labels (files.labels of a "
            "description); boxes.labels names their folder",
            code=UNUSED_OPTION,
        )


def _with_note(frames: FrameSet, note: str) -> FrameSet:
    notes = frames.notes
    return replace(frames, notes=lambda: (note, *notes()))


def describe_source(
    source: Path, file: Path | None = None, options: Mapping[str, object] | None = None
) -> RecordingDescription:
    """The description of a recording, as `describe` makes it, or that of its recorder.

    A folder without a description, whose layout is neither named nor recognised, may be
    a recording of a public recorder, whose description came with the product. Raises
    `LayoutError` or `ConfigError`: as `describe`.
    """
    description = describe(source, file, options)
    is_described = file or (source / RECORDING_NAME).is_file()
    if is_described or description.own_layout != "auto" or not source.is_dir():
        return description
    recorder = recorder_of(source)
    if recorder is None:
        return description
    candidates, fallbacks = _recognised(source, description)
    if candidates or MANIFEST.name in fallbacks:
        return description
    values = {**recorder.values, "recorder": recorder.name}
    return describe(source, options={**values, **(options or {})})


def detect_layout(source: Path, description: RecordingDescription | None = None) -> str:
    """The name of the one layout that a folder or a file has, also that of a plug-in.

    Files that the description ignores are not looked at. Raises `LayoutError`: none or
    several; names what was looked for or found.
    """
    candidates = possible_layouts(source, description)
    if len(candidates) == 1:
        return candidates[0]
    if candidates:
        raise LayoutError(
            f"{name_of(source)}: could be {' or '.join(candidates)}; name the layout"
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
    tried = (
        file_format for file_format in _in_order_of_trial() if file_format.recognise
    )
    *first, last = (file_format.recognised_by for file_format in tried)
    examined = Source(source, (description or RecordingDescription()).files)
    lacking = lacking_class_list(examined)
    problem = f"no layout recognised; expected {', '.join(first)}, or {last}"
    if lacking:
        raise NoClassList(f"{name_of(source)}: {problem}; {lacking}")
    raise LayoutError(f"{name_of(source)}: {problem}")


def possible_layouts(
    source: Path, description: RecordingDescription | None = None
) -> tuple[str, ...]:
    """The names of the layouts that a folder or a file may have, the likeliest first.

    No format is tried after one that is certain. Parameters are those of
    `detect_layout`.
    """
    candidates, fallbacks = _recognised(source, description or RecordingDescription())
    return tuple(candidates or fallbacks[:1])


def _recognised(
    source: Path, description: RecordingDescription
) -> tuple[list[str], list[str]]:
    """The layouts that a source may have, and those that it can be read in at least."""
    examined = Source(source, description.files)
    candidates: list[str] = []
    fallbacks: list[str] = []
    for file_format in _in_order_of_trial():
        with _blaming_plugin(file_format):
            recognition = (
                file_format.recognise(examined) if file_format.recognise else "none"
            )
        if recognition == "fallback":
            fallbacks.append(file_format.name)
        elif recognition != "none":
            candidates.append(file_format.name)
        if recognition == "certain":
            break
    return candidates, fallbacks


def _in_order_of_trial() -> Iterator[Format]:
    yield from _IN_ORDER_OF_TRIAL
    yield from plugins().formats.values()


def write_export(
    name: str,
    frames: Iterable[ExportFrame],
    sink: Sink,
    head: ExportHead,
    options: ExportOptions,
) -> Counts:
    """Write frames in one of `EXPORT_FORMATS`; returns the counts of ``manifest.json``.

    `frames` are read once, one at a time. `sink` gets each file whole before the next
    begins; ``manifest.json`` last.

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
    export_format = FORMATS[name]
    for option in sorted(non_default_options(options) - export_format.options):
        allowed = ", ".join(sorted(export_format.options)) or "none"
        raise ExportError(
            f"format {name!r} has no option {option!r}; it has {allowed}",
            pointer=f"/options/{option}",
        )
    if export_format.require is not None:
        export_format.require()
    return export_format
