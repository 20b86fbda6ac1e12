"""What every reader yields: a frame's files and annotation, and what did not match."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from filter_core.errors import FilterError, LayoutError

MAX_LABEL_BYTES: Final = 16 * 1024 * 1024
"""A larger label file is not one: ten thousand boxes take under a megabyte."""


@dataclass(frozen=True)
class FrameSource:
    """One frame as a folder holds it.

    Attributes
    ----------
    key : str
        Names the frame; may contain ``/``.
    annotation : dict or None
        As `filter_core.annotation.parse_annotation` takes it; None if `problem`.
    image, segmentation : Path or None
    others : mapping of str to Path
        ``depth``, ``instances``, ``lidar``, ``radar``, ``ignore_mask`` where given.
    problem : FilterError or None
        Why the frame cannot be used; the others go on.
    """

    key: str
    annotation: dict[str, Any] | None
    image: Path | None = None
    segmentation: Path | None = None
    others: Mapping[str, Path] = field(default_factory=dict)
    problem: FilterError | None = None


@dataclass(frozen=True)
class Unmatched:
    """A file that belongs to no frame, relative to the folder, and why."""

    path: str
    why: str


@dataclass(frozen=True)
class FrameSet:
    """The frames of one folder, read one at a time while iterating.

    Attributes
    ----------
    layout : str
    classes : tuple of str or None
        The layout's own list of classes, in its order.
    count : int or None
        Number of frames, None where only reading tells.
    unmatched : tuple of Unmatched
    """

    layout: str
    frames: Callable[[], Iterator[FrameSource]]
    classes: tuple[str, ...] | None = None
    count: int | None = None
    unmatched: tuple[Unmatched, ...] = ()

    def __iter__(self) -> Iterator[FrameSource]:
        return self.frames()


@dataclass(frozen=True)
class ReadOptions:
    """How a folder is to be read, where it does not say itself.

    Attributes
    ----------
    segmentation : Path or None
        The folder of the segmentations, if it is not the layout's own.
    labels : Path or None
        The folder of the labels, if it is not the layout's own.
    classes : tuple of str or None
        Names of the classes by index, instead of the layout's own list.
    default_class : str
        The class of labels that carry none.
    """

    segmentation: Path | None = None
    labels: Path | None = None
    classes: Sequence[str] | None = None
    default_class: str = "unknown"


def read_label_text(path: Path, name: str) -> str:
    """A label file's text.

    Raises
    ------
    LayoutError
        Not there, too large, or not UTF-8; names the file, never its folder.
    """
    try:
        content = read_label_bytes(path, name)
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as exc:
        raise LayoutError(
            f"{name}: expected UTF-8 text, found byte {exc.object[exc.start]:#04x} "
            f"at position {exc.start}"
        ) from exc


def read_label_bytes(path: Path, name: str) -> bytes:
    """A label file's bytes; `LayoutError` as `read_label_text`."""
    try:
        size = path.stat().st_size
        if size > MAX_LABEL_BYTES:
            raise LayoutError(
                f"{name}: expected at most {MAX_LABEL_BYTES} bytes, found {size}"
            )
        return path.read_bytes()
    except OSError as exc:
        raise LayoutError(f"{name}: cannot be read: {exc.strerror}") from exc
