"""A folder on this machine, on all cores: decided, compared, or converted.

Many frames through the filter on all cores: in order, with bounded memory.

A folder's channels compared with the truth, without a server.

Frames of a folder on their way into another format, with no server in between.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from filter_core.annotation.parsing import parse_annotation
from filter_core.config.filter import FilterConfig
from filter_core.config.keys import files_for
from filter_core.errors import FilterError, LayoutError, problem_of
from filter_core.evaluation.comparison import COMPARED, Evaluation
from filter_core.evidence.channels import SensorFiles
from filter_core.formats.export import ExportFrame, export_boxes
from filter_core.formats.reading import FrameSource
from filter_core.images.header import read_image_header
from filter_core.images.ignore_mask import read_ignore_mask
from filter_core.json_text import read_json
from filter_core.pipeline import (
    FrameOptions,
    FrameResult,
    MeasuredFrame,
    box_class,
    filter_frame,
    read_and_measure,
)
from filter_core.segmentation.reading import SegmentationOptions
from filter_core.types import NOT_MEASURED, BoolArray, Evidence, IntArray

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


INSTANCES: Final = "instances"

_MAX_LINE: Final = 1 << 20

Truth = Mapping[str, Mapping[str, bool]]
"""Whether each box is visible, by the frame's key and the box's id."""


@dataclass(frozen=True)
class EvaluationTask:
    """What is compared.

    Attributes
    ----------
    config : FilterConfig
    truth : Truth, or None
        None: an object is visible if its instance has a pixel.
    channels : names out of `filter_core.evaluation.COMPARED`
    dataset : SegmentationOptions
        How segmentations are to be read.
    """

    config: FilterConfig = field(default_factory=FilterConfig)
    truth: Truth | None = None
    channels: tuple[str, ...] = COMPARED
    dataset: SegmentationOptions = field(default_factory=SegmentationOptions)


@dataclass(frozen=True, eq=False)
class KnownBoxes:
    """Boxes of one frame whose truth is known: N `ids`, `evidence` and `visible`."""

    key: str
    ids: tuple[str, ...]
    evidence: Evidence
    visible: BoolArray

    def name_of(self, row: int) -> dict[str, str]:
        """What a box is called in lists."""
        return {"key": self.key, "id": self.ids[row]}


@dataclass(frozen=True)
class _Measured:
    key: str
    frame: MeasuredFrame | None = None
    error: dict[str, Any] | None = None


def evaluate_source(
    frames: Iterable[FrameSource],
    task: EvaluationTask,
    *,
    progress: Callable[[], None] = lambda: None,
    also: Callable[[KnownBoxes], None] = lambda _: None,
    workers: int | None = None,
) -> tuple[Evaluation, list[dict[str, Any]]]:
    """Measure every channel of many frames and count them.

    Parameters
    ----------
    frames : iterable of FrameSource
    task : EvaluationTask
    progress : callable
        Called after each frame.
    also : callable
        Is given the boxes of each frame whose truth is known, in the frames' order.
    workers : int, optional
        Threads; as many as there are cores.

    Returns
    -------
    Evaluation
    problems : list of {"key", "error"}
        Frames that could not be used; the others were counted.
    """
    measured_too = () if task.truth is not None else ("instance",)
    wanted = tuple(dict.fromkeys((*task.channels, *measured_too)))
    evaluation = Evaluation(task.config, task.channels)
    problems: list[dict[str, Any]] = []

    def work(source: FrameSource) -> _Measured:
        try:
            frame = measure_source(source, task.config, task.dataset, wanted)
        except FilterError as error:
            return _Measured(source.key, error=problem_of(error))
        return _Measured(source.key, frame)

    for one in in_order(work, frames, workers):
        if one.frame is None:
            problems.append({"key": one.key, "error": one.error})
        else:
            boxes = _known(one.key, one.frame, task.truth)
            if len(boxes.ids):
                evaluation.add(boxes.evidence, boxes.visible, name_of=boxes.name_of)
                also(boxes)
        progress()
    return evaluation, problems


def _known(key: str, frame: MeasuredFrame, truth: Truth | None) -> KnownBoxes:
    """Without boxes whose truth is not known."""
    rows, visible = _by_instances(frame) if truth is None else _told(key, frame, truth)
    ids = tuple(frame.ids[row] for row in rows.tolist())
    return KnownBoxes(key, ids, frame.evidence.take(rows), visible)


def _by_instances(frame: MeasuredFrame) -> tuple[IntArray, BoolArray]:
    channels = frame.evidence.channels
    if channels is None:
        return np.empty(0, np.int64), np.empty(0, np.bool_)
    rows = np.flatnonzero(channels.instance_pixels != NOT_MEASURED)
    return rows, channels.instance_pixels[rows] > 0


def _told(key: str, frame: MeasuredFrame, truth: Truth) -> tuple[IntArray, BoolArray]:
    told = truth.get(key, {})
    rows = [row for row, box_id in enumerate(frame.ids) if box_id in told]
    visible = [told[frame.ids[row]] for row in rows]
    return np.array(rows, np.int64), np.array(visible, np.bool_)


def read_truth(path: Path) -> dict[str, dict[str, bool]]:
    """Lines of ``{"key", "id", "visible"}``; other keys are not looked at.

    Raises
    ------
    LayoutError
        Which line is wrong, and how.
    """
    truth: dict[str, dict[str, bool]] = {}
    for number, line in _lines(path):
        try:
            told: Any = read_json(line)
            key, box_id, visible = told["key"], told["id"], told["visible"]
        except (ValueError, TypeError, KeyError) as error:
            raise LayoutError(
                f"{path.name}, line {number}: expected an object with key, id and "
                f"visible, found {line[:60]!r}"
            ) from error
        if not isinstance(visible, bool):
            raise LayoutError(
                f"{path.name}, line {number}: visible: expected true or false, "
                f"found {visible!r}"
            )
        truth.setdefault(str(key), {})[str(box_id)] = visible
    return truth


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    try:
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(
                iter(lambda: file.readline(_MAX_LINE), ""), 1
            ):
                if line.strip():
                    yield number, line
    except (OSError, UnicodeDecodeError) as error:
        raise LayoutError(f"{path.name} cannot be read as UTF-8 lines") from error


_KNOWN: Final = (
    "car",
    "truck",
    "van",
    "bus",
    "motorcycle",
    "bicycle",
    "walker",
    "traffic_light",
    "vehicle",
)


@dataclass(frozen=True)
class LeftOut:
    """A frame that cannot be exported, and why."""

    key: str
    problem: FilterError


def export_sources(
    frames: Iterable[FrameSource],
    config: FilterConfig,
    *,
    measure: bool = False,
    workers: int | None = None,
) -> Generator[ExportFrame | LeftOut, None, None]:
    """Frames of a folder as the writers of formats take them.

    Parameters
    ----------
    frames : iterable of FrameSource
        Read only a few frames ahead.
    config : FilterConfig
    measure : bool
        Read the segmentations, so that the filter decides; else all boxes that are in
        the image are ``unmeasured``.
    workers : int, optional

    Yields
    ------
    ExportFrame or LeftOut
        In the order of the frames; one that cannot be read does not stop the others.
    """
    return in_order(lambda one: _export_frame(one, config, measure), frames, workers)


def class_order(frames: Iterable[FrameSource]) -> tuple[str, ...]:
    """The classes of frames whose layout has no list of them, in an order that lasts.

    The filter's own classes come in its own order, then all others by name: neither
    the order of the frames nor how often a class occurs makes a difference.
    """
    found: set[str] = set()
    for frame in frames:
        try:
            annotation = parse_annotation(frame.annotation or {}, frame=frame.key)
        except FilterError:
            # It is named when its turn comes; here only its classes are missed.
            continue
        found.update(map(box_class, annotation.boxes))
    known = [name for name in _KNOWN if name in found]
    return (*known, *sorted(found - set(known)))


def _export_frame(
    source: FrameSource, config: FilterConfig, measure: bool
) -> ExportFrame | LeftOut:
    try:
        return _decided(source, config, measure)
    except FilterError as problem:
        return LeftOut(source.key, problem)


def _decided(source: FrameSource, config: FilterConfig, measure: bool) -> ExportFrame:
    if not measure:
        # A mask would be read for nothing, and depth or LiDAR as well.
        source = replace(source, segmentation=None, others={})
    result = decide_source(source, config, SegmentationOptions())
    measured = result.measured
    annotation = measured.annotation
    decisions = result.decisions if measure else map(_undecided, result.decisions)
    frame = ExportFrame(
        key=source.key,
        wh=measured.wh,
        boxes=export_boxes(annotation, decisions, measured.geometry),
        map=annotation.map,
        palette=(measured.segmentation or {}).get("palette"),
        annotation=annotation.raw,
        camera=annotation.camera,
    )
    return _with_image(frame, source)


def _undecided(decision: dict[str, Any]) -> dict[str, Any]:
    """A box in the image that nothing was measured of, whatever its class."""
    if decision["xyxy"] is None:
        return decision
    return {**decision, "verdict": "unmeasured", "reason": "no_segmentation"}


def _with_image(frame: ExportFrame, source: FrameSource) -> ExportFrame:
    path = source.image
    if path is None:
        return frame
    try:
        media_type = read_image_header(path.read_bytes()).media_type
    except OSError as exc:
        raise LayoutError(f"{path.name}: cannot be read: {exc.strerror}") from exc
    return replace(frame, read_image=path.read_bytes, media_type=media_type)
