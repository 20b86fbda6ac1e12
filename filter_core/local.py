"""Many frames through the filter on all cores: in order, with bounded memory."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any, Final, TypeVar

from filter_core.config.filter import FilterConfig
from filter_core.errors import AnnotationErrors, FilterError, LayoutError
from filter_core.evidence.channels import SensorFiles, files_for
from filter_core.formats.reading import FrameSource
from filter_core.images.header import read_image_header
from filter_core.images.ignore_mask import read_ignore_mask
from filter_core.pipeline import (
    FrameOptions,
    FrameResult,
    MeasuredFrame,
    filter_frame,
    read_and_measure,
)
from filter_core.segmentation.reading import SegmentationOptions

Given = TypeVar("Given")

Made = TypeVar("Made")

_AHEAD: Final = 4
"""Frames per worker that may wait for their turn to be handed out."""


@dataclass(frozen=True)
class FrameOutcome:
    """One frame's decisions, or why it has none."""

    key: str
    palette: str | None = None
    decisions: list[dict[str, Any]] | None = None
    error: dict[str, Any] | None = None

    def as_dict(self) -> dict[str, Any]:
        """The line that stands for this frame in a decisions file."""
        if self.error is not None:
            return {"key": self.key, "error": self.error}
        return {"key": self.key, "palette": self.palette, "decisions": self.decisions}


def filter_source(
    frames: Iterable[FrameSource],
    config: FilterConfig,
    *,
    dataset: SegmentationOptions | None = None,
    workers: int | None = None,
) -> Generator[FrameOutcome, None, None]:
    """Decide the boxes of many frames.

    Parameters
    ----------
    frames : iterable of FrameSource
        Read only a few frames ahead, so that its length does not matter.
    config : FilterConfig
    dataset : SegmentationOptions, optional
        How the segmentations are to be read, above what the config says.
    workers : int, optional
        Threads; one more than there are cores. Pixel work runs outside Python's lock,
        and while one thread waits for the lock, another keeps its core at work.

    Yields
    ------
    FrameOutcome
        In the order of the frames; a frame that cannot be used has an error, and the
        others go on.
    """
    reading = dataset or SegmentationOptions()
    return in_order(lambda one: filter_one(one, config, reading), frames, workers)


def in_order(
    work: Callable[[Given], Made], items: Iterable[Given], workers: int | None = None
) -> Generator[Made, None, None]:
    """Work on many items in threads; the results come in the order of the items.

    Only a few items are taken ahead, so that their number does not matter.
    """
    count = workers or (os.cpu_count() or 1) + 1
    waiting: deque[Future[Made]] = deque()
    with ThreadPoolExecutor(count, thread_name_prefix="filter") as pool:
        try:
            for item in items:
                waiting.append(pool.submit(work, item))
                if len(waiting) >= count * _AHEAD:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            # Whoever stops listening does not wait for frames nobody will see.
            for future in waiting:
                future.cancel()


def filter_one(
    source: FrameSource, config: FilterConfig, dataset: SegmentationOptions
) -> FrameOutcome:
    """Decide the boxes of one frame of a folder; never raises for bad input."""
    try:
        result = decide_source(source, config, dataset)
    except FilterError as exc:
        return FrameOutcome(source.key, error=problem_of(exc))
    palette = (result.measured.segmentation or {}).get("palette")
    return FrameOutcome(source.key, palette, result.decisions)


def decide_source(
    source: FrameSource, config: FilterConfig, dataset: SegmentationOptions
) -> FrameResult:
    """Decide the boxes of one frame of a folder; raises what is wrong with it."""
    if source.problem is not None:
        raise source.problem
    options = _frame_options(source, files_for(config.channels), dataset)
    return filter_frame(source.annotation or {}, _segmentation(source), config, options)


def measure_source(
    source: FrameSource,
    config: FilterConfig,
    dataset: SegmentationOptions,
    channels: tuple[str, ...],
) -> MeasuredFrame:
    """Measure one frame of a folder under several channels, and decide nothing.

    Raises
    ------
    FilterError
        What is wrong with the frame.
    """
    if source.problem is not None:
        raise source.problem
    options = _frame_options(source, files_for(channels), dataset)
    options = replace(options, sensors=replace(options.sensors, channels=channels))
    return read_and_measure(
        source.annotation or {}, _segmentation(source), config, options
    )


def problem_of(error: FilterError) -> dict[str, Any]:
    """An error as the problem object that the API answers, without its HTTP part."""
    several = error if isinstance(error, AnnotationErrors) else None
    more = several.more_errors if several else 0
    return {
        "title": type(error).__name__,
        "detail": error.detail,
        "code": error.kind,
        "errors": [
            {"pointer": part.pointer, "code": part.kind, "detail": part.detail}
            for part in (several.errors if several else (error,))
        ],
        **({"more_errors": more} if more else {}),
    }


def _frame_options(
    source: FrameSource, kinds: tuple[str, ...], dataset: SegmentationOptions
) -> FrameOptions:
    wh = None
    if source.image is not None:
        wh = _size(source.image)
    ignore = None
    if "ignore_mask" in source.others and wh is not None:
        content = _read(source.others["ignore_mask"], "ignore_mask")
        ignore = read_ignore_mask(content, wh)
    sensors = SensorFiles(
        {
            kind: _read(source.others[kind], kind)
            for kind in kinds
            if kind in source.others
        }
    )
    return FrameOptions(
        key=source.key, image_wh=wh, dataset=dataset, ignore=ignore, sensors=sensors
    )


def _segmentation(source: FrameSource) -> bytes | None:
    if source.segmentation is None:
        return None
    return _read(source.segmentation, "segmentation")


def _size(image: Path) -> tuple[int, int]:
    """Width and height; of a file of a megabyte and more, two pages are read."""
    with _opening(image, "image"), image.open("rb") as file:
        if not os.fstat(file.fileno()).st_size:
            return read_image_header(b"").wh
        with mmap(file.fileno(), 0, access=ACCESS_READ) as content:
            return read_image_header(content, whole=False).wh


def _read(path: Path, what: str) -> bytes:
    with _opening(path, what):
        return path.read_bytes()


@contextmanager
def _opening(path: Path, what: str) -> Iterator[None]:
    try:
        yield
    except OSError as exc:
        raise LayoutError(
            f"{what}: {path.name} cannot be read: {exc.strerror}"
        ) from exc
