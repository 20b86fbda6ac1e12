"""Which files outside a recording's folder may be read.

A folder that somebody else made could name private files, by a path in a manifest or by
a symbolic link, and a program that uploads would then send them. So they are refused,
unless the description of the recording allows them.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

from filter_core.errors import LayoutError
from filter_core.formats.reading import (
    IMAGE_SUFFIXES,
    TEXT_SUFFIXES,
    FrameSet,
    FrameSource,
    is_hidden,
    is_inside,
    name_of,
    real_paths,
)
from filter_core.formats.recording import RecordingDescription
from filter_core.values import shown

OUTSIDE_FILES_HINT: Final = (
    "--root DIR (roots) names a folder whose files may be read, --outside-files "
    "(outside_files) allows all"
)
"""The remedies, for command line and library."""


def allowed_folders(
    description: RecordingDescription, *folders: Path | None
) -> tuple[Path, ...] | None:
    """The `real_paths` in which every file must lie; None: a file may lie anywhere.

    They are `folders`, those of the segmentations and labels, and the roots that the
    description names. `is_inside` takes them.
    """
    if description.outside_files is not False:
        return None
    named = (*folders, description.segmentation, description.labels)
    return real_paths(*filter(None, named), *description.roots)


def check_links(source: Path, description: RecordingDescription) -> None:
    """Refuse a folder with a symbolic link that leads out of it.

    A link may lead to what was named: the source itself and the folders that the
    description names. Links to files that no reader opens are not looked at. Raises
    `LayoutError`: there is such a link; names the first one.
    """
    allowed = allowed_folders(description, source)
    if allowed is None:
        return
    for each in filter(None, (source, description.segmentation, description.labels)):
        for link in _links(each):
            if not is_inside(link, allowed):
                raise LayoutError(
                    f"{name_of(each)}: expected no link out of the folder, found "
                    f"{shown(link.relative_to(each).as_posix())}; {OUTSIDE_FILES_HINT}"
                )


def files_inside(
    frames: FrameSet, source: Path, description: RecordingDescription
) -> FrameSet:
    """The frames of a file that was named itself, such as COCO's, or of patterns.

    A frame with a file outside the folder of `source` has that as its problem. The
    folder of a file is not searched for links: it may be one with much else in it.
    """
    folder = source if source.is_dir() else source.parent
    allowed = allowed_folders(description, source, folder)
    if allowed is None:
        return frames

    def checked() -> Iterator[FrameSource]:
        for frame in frames.frames():
            files = (frame.image, frame.segmentation, *frame.others.values())
            outside = [file for file in files if file and not is_inside(file, allowed)]
            if not outside:
                yield frame
                continue
            problem = LayoutError(
                f"frame {frame.key}: expected a file in the folder, found "
                f"{shown(outside[0].name)}, a link out of it; {OUTSIDE_FILES_HINT}"
            )
            yield FrameSource(key=frame.key, annotation=None, problem=problem)

    return replace(frames, frames=checked)


def _links(folder: Path) -> Iterator[Path]:
    """Links to folders that some reader enters, and to files that one opens."""
    try:
        with os.scandir(folder) as entries:
            ordered = sorted(entries, key=lambda entry: entry.name)
    except OSError:  # no reader can list it, either
        return
    for entry in ordered:
        if entry.is_symlink():
            path = folder / entry.name
            is_entered = path.is_dir() and not is_hidden(entry.name)
            if is_entered or path.suffix.lower() in (*IMAGE_SUFFIXES, *TEXT_SUFFIXES):
                yield path
        elif entry.is_dir() and not is_hidden(entry.name):
            yield from _links(folder / entry.name)
