"""Many frames through the filter on all cores: in order, with bounded memory."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from filter_core.config import FilterConfig
from filter_core.errors import AnnotationErrors, FilterError, LayoutError
from filter_core.formats.frame_source import FrameSource
from filter_core.frame_filter import FrameOptions, filter_frame
from filter_core.ignore_mask import read_ignore_mask
from filter_core.image_header import read_image_header
from filter_core.segmentation import SegmentationOptions

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
        Threads; as many as there are cores. Pixel work runs outside Python's lock.

    Yields
    ------
    FrameOutcome
        In the order of the frames; a frame that cannot be used has an error, and the
        others go on.
    """
    count = workers or os.cpu_count() or 1
    reading = dataset or SegmentationOptions()
    waiting: deque[Future[FrameOutcome]] = deque()
    with ThreadPoolExecutor(count, thread_name_prefix="filter") as pool:
        try:
            for source in frames:
                waiting.append(pool.submit(filter_one, source, config, reading))
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
        if source.problem is not None:
            raise source.problem
        options = _frame_options(source, dataset)
        tags = None
        if source.segmentation is not None:
            tags = _read(source.segmentation, "segmentation")
        result = filter_frame(source.annotation or {}, tags, config, options)
    except FilterError as exc:
        return FrameOutcome(source.key, error=problem_of(exc))
    palette = (result.measured.segmentation or {}).get("palette")
    return FrameOutcome(source.key, palette, result.decisions)


def problem_of(error: FilterError) -> dict[str, Any]:
    """An error as the problem object that the API answers, without its HTTP part."""
    parts = error.errors if isinstance(error, AnnotationErrors) else (error,)
    return {
        "title": type(error).__name__,
        "detail": error.detail,
        "code": error.kind,
        "errors": [
            {"pointer": part.pointer, "code": part.kind, "detail": part.detail}
            for part in parts
        ],
    }


def _frame_options(source: FrameSource, dataset: SegmentationOptions) -> FrameOptions:
    wh = None
    if source.image is not None:
        wh = read_image_header(_read(source.image, "image")).wh
    ignore = None
    if "ignore_mask" in source.others and wh is not None:
        content = _read(source.others["ignore_mask"], "ignore_mask")
        ignore = read_ignore_mask(content, wh)
    return FrameOptions(key=source.key, image_wh=wh, dataset=dataset, ignore=ignore)


def _read(path: Path, what: str) -> bytes:
    try:
        return path.read_bytes()
    except OSError as exc:
        raise LayoutError(
            f"{what}: {path.name} cannot be read: {exc.strerror}"
        ) from exc
