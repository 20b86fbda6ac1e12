"""Frames of a folder on this machine, found by the library's readers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from unghost.cli.config_files import naming
from unghost.cli.exits import Refused
from unghost.outgoing import NotSent, OutgoingFrame

if TYPE_CHECKING:
    from filter_core.config.filter import FilterConfig
    from filter_core.formats.reading import FrameSet, FrameSource
    from unghost.cli.screen import Screen
    from unghost.cli.source_options import SegmentationReading, SourceOptions


def open_source(path: Path, options: SourceOptions) -> FrameSet:
    """The frames of a folder or a manifest; LayoutError if it is neither."""
    from filter_core.formats.reading import ReadOptions
    from filter_core.formats.registry import read_source

    read = ReadOptions(
        segmentation=options.segmentation,
        labels=options.labels,
        classes=options.class_list,
        default_class=options.default_class,
    )
    found = read_source(path, options.layout, read)
    if found.count is None and found.layout == "manifest":
        found = replace(found, count=_lines(path))
    if found.count == 0:
        raise Refused(f"no frames in {path.name} (layout {found.layout})")
    return found


def read_config(
    path: Path | None, reading: SegmentationReading, screen: Screen
) -> FilterConfig:
    """A file's configuration, with what the command line says on top."""
    from filter_core.config.file import load_config
    from filter_core.config.filter import FilterConfig

    with naming(path):
        loaded = load_config(path.read_bytes() if path is not None else b"")
    if loaded.unused_keys:
        screen.note(f"not used here: {', '.join(loaded.unused_keys)}")
    return FilterConfig.from_mapping({**loaded.config.as_dict(), **reading.reading})


def _lines(source: Path) -> int:
    """Frames of a manifest, for the bar: reading it costs little beside the images."""
    from filter_core.formats.manifest import MANIFEST_NAME

    manifest = source / MANIFEST_NAME if source.is_dir() else source
    with manifest.open("rb") as lines:
        return sum(1 for line in lines if line.strip())


def outgoing(frames: Iterable[FrameSource]) -> Iterator[OutgoingFrame | NotSent]:
    """Frames as they are sent; one that cannot be read says why."""
    for frame in frames:
        if frame.problem is not None:
            yield NotSent(frame.key, frame.problem)
        else:
            yield OutgoingFrame(frame.key, frame.annotation or {}, _files(frame))


def _files(frame: FrameSource) -> dict[str, Path]:
    named = {"image": frame.image, "segmentation": frame.segmentation, **frame.others}
    return {name: path for name, path in named.items() if path is not None}
