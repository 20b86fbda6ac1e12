"""Filters, evaluates or converts a folder of frames on this machine.

`filter_source` decides the boxes of all frames, `evaluate_source` compares the kinds of
evidence with the ground truth, and `export_sources` prepares the frames for the writers
of another format. All three take frames from a reader of `filter_core.formats`, process
a few of them at a time in threads, and yield results in the order of the frames, so
memory does not grow with the folder. A frame that cannot be used gives a result with
the reason, and the other frames are processed.
"""

from __future__ import annotations

import os
from collections import Counter, deque
from collections.abc import (
    Callable,
    Collection,
    Generator,
    Iterable,
    Iterator,
    Mapping,
    Sequence,
)
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Final, Literal, NamedTuple, TypeAlias, TypeVar

import numpy as np

from filter_core.annotation.frame import FrameAnnotation
from filter_core.annotation.parsing import parse_annotation
from filter_core.arrays import NOT_MEASURED, BoolArray, BoxesXYXY
from filter_core.classes import CLASSES
from filter_core.config.filter import FilterConfig
from filter_core.config.measure import MeasureConfig
from filter_core.decisions.record import Decision, decided_boxes, decision_columns
from filter_core.decisions.rules import decide
from filter_core.errors import (
    FilterError,
    LayoutError,
    ProblemObject,
    file_context,
    problem_of,
)
from filter_core.evaluation.arms import (
    DOUBTFUL,
    GHOST,
    OBJECT,
    Arm,
    BoxTruth,
    LabelledBoxes,
    ProjectedBoxes,
    label_boxes,
    truth_of_pixels,
)
from filter_core.evaluation.comparison import COMPARED, Evaluation, truth_from_instances
from filter_core.evidence_kinds import EvidenceName, files_for
from filter_core.evidence_numbers import Evidence
from filter_core.formats.export import ExportFrame, GivenAnnotation
from filter_core.formats.format import Need
from filter_core.formats.reading import (
    FrameSource,
    missing_image,
    open_regular,
    opening_file,
    read_file,
)
from filter_core.formats.writing import clipped
from filter_core.images.drawing import DrawnBox, png_with_boxes
from filter_core.images.header import read_image_header
from filter_core.images.ignore_mask import read_ignore_mask
from filter_core.json_text import read_json
from filter_core.pipeline import (
    FrameOptions,
    FrameResult,
    MeasuredFrame,
    box_class,
    read_and_measure,
)
from filter_core.segmentation.reading import SegmentationOptions, in_colors
from filter_core.verdicts import REJECTED, VERDICT_OF_REASON, Decisions, Reason

_Given = TypeVar("_Given")

_Made = TypeVar("_Made")

_UNMAPPED: Final = (int(Reason.UNMAPPED_CLASS), int(Reason.DROPPED_CLASS))

_IS_REJECTED: Final = (VERDICT_OF_REASON == REJECTED).tolist()
"""By the number of a `Reason`."""

_AHEAD: Final = 4
"""Frames per worker that are in progress or wait for an earlier frame."""

_MAX_LINE: Final = 1 << 20
"""Characters of a ground truth file that are read at a time, in lines of any length."""


class ClassCount(NamedTuple):
    """The boxes of one class.

    Attributes
    ----------
    unmapped : int
        Boxes of which nothing is known, because no class is known that the name means.
    pixels, unknown_pixels : int
        Of all boxes that a segmentation was measured for; those whose tag or colour is
        unknown.
    """

    boxes: int = 0
    rejected: int = 0
    unmapped: int = 0
    pixels: int = 0
    unknown_pixels: int = 0

    def plus(self, other: ClassCount) -> ClassCount:
        """The sums of both."""
        return ClassCount(*map(sum, zip(self, other, strict=True)))


def count_by_class(evidence: Evidence, verdicts: Decisions) -> dict[str, ClassCount]:
    """The boxes of a frame, counted by class."""
    rows = [[0] * len(ClassCount._fields) for _ in evidence.class_names]
    # A loop: for the few boxes of a frame, it is faster than arrays.
    for index, reason, is_measured, pixels, unknown in zip(
        evidence.class_index.tolist(),
        verdicts.reason.tolist(),
        evidence.measured.tolist(),
        evidence.box_pixels.tolist(),
        evidence.unknown_pixels.tolist(),
        strict=True,
    ):
        row = rows[index]
        row[0] += 1
        row[1] += _IS_REJECTED[reason]
        row[2] += reason in _UNMAPPED
        if is_measured:
            row[3] += pixels
            row[4] += unknown
    return {
        name: ClassCount(*row)
        for name, row in zip(evidence.class_names, rows, strict=True)
        if row[0]
    }


@dataclass(frozen=True)
class FrameOutcome:
    """One frame's decisions, or why it has none.

    Attributes
    ----------
    palette : str or None
        The tag family of its segmentation; None if there was none.
    decisions : list of Decision, or None
        In the order of its boxes; None if there is an error.
    error : ProblemObject or None
        Why the frame cannot be used.
    notes : tuple of str
        What a person should know about how its depth and instance image were read.
    classes : mapping of str to ClassCount
        Its boxes by class.
    """

    key: str
    palette: str | None = None
    decisions: list[Decision] | None = None
    error: ProblemObject | None = None
    notes: tuple[str, ...] = ()
    classes: Mapping[str, ClassCount] = field(default_factory=dict)

    def as_dict(self) -> dict[str, object]:
        """The line of this frame in a decisions file."""
        if self.error is not None:
            return {"key": self.key, "error": self.error}
        notes = {"notes": self.notes} if self.notes else {}
        return {
            "key": self.key,
            "palette": self.palette,
            **notes,
            "decisions": self.decisions,
        }


def filter_source(
    frames: Iterable[FrameSource], config: FilterConfig, *, workers: int | None = None
) -> Generator[FrameOutcome, None, None]:
    """Decide the boxes of many frames, in their order.

    Only a few frames are read ahead, so there may be any number of them. One that
    cannot be used has an error, and the others go on. `workers` are threads, by default
    one more than there are cores: pixel work runs outside Python's lock, and while one
    thread waits for the lock, another keeps its core at work.
    """
    return in_order(lambda frame: filter_one(frame, config), frames, workers)


def outcomes(
    frames: Iterable[FrameSource], config: FilterConfig | None
) -> Generator[tuple[FrameSource, FrameOutcome], None, None]:
    """Frames with their decisions, in their order; only a few are read ahead.

    Without a `config` nothing is decided; an outcome only says what is wrong with its
    frame.
    """

    def outcome(source: FrameSource) -> tuple[FrameSource, FrameOutcome]:
        if config is not None:
            return source, filter_one(source, config)
        problem = source.problem or missing_image(source)
        error = problem_of(problem) if problem else None
        return source, FrameOutcome(source.key, error=error)

    return in_order(outcome, frames)


def filter_one(source: FrameSource, config: FilterConfig) -> FrameOutcome:
    """Decide the boxes of one frame of a folder; never raises for bad input.

    Parameters are those of `filter_source`.
    """
    try:
        measured = measure_source(source, config, config.channels)
        verdicts = decide(measured.evidence, config)
        decisions = FrameResult(measured, verdicts, config).decisions
    except FilterError as error:
        return FrameOutcome(source.key, error=problem_of(error))
    return FrameOutcome(
        source.key,
        measured.palette,
        decisions,
        notes=measured.notes,
        classes=count_by_class(measured.evidence, verdicts),
    )


Truth = Mapping[str, Mapping[str, bool]]
"""Whether each box is visible, by the frame's key and the box's id."""


@dataclass(frozen=True)
class LeftOut:
    """A frame that cannot be used: its key, and why."""

    key: str
    problem: FilterError


@dataclass(frozen=True)
class EvaluationTask:
    """What is compared.

    Without a `truth`, an object is visible if its instance has a pixel. `channels` are
    the kinds of evidence that are compared.
    """

    config: FilterConfig = field(default_factory=FilterConfig)
    truth: Truth | None = None
    channels: tuple[EvidenceName, ...] = COMPARED


@dataclass(frozen=True, eq=False)
class KnownBoxes:
    """The N boxes of one frame, by its key, whose truth is known: (N,) bool."""

    key: str
    ids: tuple[str, ...]
    evidence: Evidence
    visible: BoolArray

    def name_of(self, row: int) -> dict[str, str]:
        """What a box is called in lists."""
        return {"key": self.key, "id": self.ids[row]}


def evaluate_source(
    frames: Iterable[FrameSource],
    task: EvaluationTask,
    *,
    progress: Callable[[tuple[str, ...]], None] = lambda _: None,
    also: Callable[[KnownBoxes], None] = lambda _: None,
    workers: int | None = None,
) -> tuple[Evaluation, list[LeftOut]]:
    """Measure every channel of many frames and count them.

    Returns those that were left out, too. `progress` is called after each frame, with
    its `MeasuredFrame.notes`, and `also` with the boxes of known truth of each, in the
    frames' order. `workers` are threads, by default one more than there are cores.
    """
    measured_too = () if task.truth is not None else ("instance",)
    channels = tuple(dict.fromkeys((*task.channels, *measured_too)))
    evaluation = Evaluation(task.config, task.channels)
    left_out: list[LeftOut] = []

    def measured(source: FrameSource) -> MeasuredFrame | LeftOut:
        try:
            return measure_source(source, task.config, channels)
        except FilterError as problem:
            return LeftOut(source.key, problem)

    for frame in in_order(measured, frames, workers):
        if isinstance(frame, LeftOut):
            left_out.append(frame)
        else:
            if task.truth is None:
                rows, visible = truth_from_instances(frame.evidence)
            else:
                told = task.truth.get(frame.key, {})
                rows = np.flatnonzero([box_id in told for box_id in frame.ids])
                visible = np.array([told[frame.ids[row]] for row in rows], np.bool_)
            ids = tuple(frame.ids[row] for row in rows.tolist())
            boxes = KnownBoxes(frame.key, ids, frame.evidence.take(rows), visible)
            if len(boxes.ids):
                evaluation.add(boxes.evidence, boxes.visible, name_of=boxes.name_of)
                also(boxes)
        progress(() if isinstance(frame, LeftOut) else frame.notes)
    return evaluation, left_out


def read_truth(path: Path) -> dict[str, dict[str, bool]]:
    """Reads lines of ``{"key", "id", "visible"}``; other keys are ignored.

    Raises `LayoutError`: names the line and its error.
    """
    truth: dict[str, dict[str, bool]] = {}
    for key, box_id, visible, _ in _truth_lines(path):
        truth.setdefault(key, {})[box_id] = visible
    return truth


def read_box_truth(path: Path, least_pixels: int) -> dict[str, dict[str, KnownBox]]:
    """Reads such lines with ``visible_pixels``, too, where a line has them.

    A box with fewer than `least_pixels` of them is doubtful. Raises `LayoutError` as
    `read_truth`.
    """
    truth: dict[str, dict[str, KnownBox]] = {}
    for key, box_id, visible, visible_pixels in _truth_lines(path):
        pixels = NOT_MEASURED
        if (
            isinstance(visible_pixels, int)
            and not isinstance(visible_pixels, bool)
            and visible_pixels >= 0
        ):
            pixels = visible_pixels
        few = visible and 0 <= pixels < least_pixels
        box = KnownBox(int(DOUBTFUL if few else OBJECT if visible else GHOST), pixels)
        truth.setdefault(key, {})[box_id] = box
    return truth


def _truth_lines(path: Path) -> Iterator[tuple[str, str, bool, object]]:
    """Key, id, whether it is visible, and ``visible_pixels`` of each line."""
    for number, line in _lines(path):
        try:
            entry = read_json(line)
            if not isinstance(entry, dict):
                raise TypeError(f"{type(entry).__name__} is not an object")
            key, box_id, visible = entry["key"], entry["id"], entry["visible"]
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
        yield str(key), str(box_id), visible, entry.get("visible_pixels")


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Each line that is not empty, with its number."""
    try:
        with path.open(encoding="utf-8") as file:
            lines = iter(lambda: file.readline(_MAX_LINE), "")
            yield from ((at, line) for at, line in enumerate(lines, 1) if line.strip())
    except (OSError, UnicodeDecodeError) as error:
        raise LayoutError(f"{path.name} cannot be read as UTF-8 lines") from error


class KnownBox(NamedTuple):
    """The truth of one box, as `LabelledBoxes` has it: its code, its visible pixels."""

    truth: int
    pixels: int


TruthSource: TypeAlias = Literal["instances", "reviews"]
"""``instances``: the pixels of a box in the instance image tell whether it is visible.
``reviews``: people's answers tell it; what nobody kept or rejected is doubtful."""


@dataclass(frozen=True)
class ArmsTask:
    """Which arms label frames, and what tells the truth about their boxes.

    Attributes
    ----------
    config : FilterConfig
        What the arms have in common; see `Arm.config`.
    truth : TruthSource, or mapping of str to mapping of str to KnownBox
        Or the truth by the frame's key and the box's id; others are doubtful.
    least_pixels : int
        By instances, an object with fewer visible pixels is doubtful.
    """

    arms: tuple[Arm, ...]
    config: FilterConfig = field(default_factory=FilterConfig)
    truth: TruthSource | Mapping[str, Mapping[str, KnownBox]] = "instances"
    least_pixels: int = 10


@dataclass(frozen=True, eq=False)
class LabelledFrame:
    """A frame with the labels of all arms; `wh` is its size, px."""

    source: FrameSource
    annotation: FrameAnnotation
    wh: tuple[int, int]
    boxes: LabelledBoxes


def label_sources(
    frames: Iterable[FrameSource], task: ArmsTask, *, workers: int | None = None
) -> Generator[LabelledFrame | LeftOut, None, None]:
    """Measure frames and label their boxes as each arm does.

    They come in the order of `frames`. One that cannot be used does not stop the
    others. `workers` are as for `evaluate_source`.
    """
    configs = {arm.name: arm.config(task.config) for arm in task.arms}
    exact = replace(task.config, profile="paper", projection="clipped")
    naive = replace(task.config, profile="carlasimu", projection="naive")
    is_published = any(
        config and config.profile == "carlasimu" for config in configs.values()
    )
    kinds = {name for config in configs.values() if config for name in config.channels}
    if task.truth == "instances":
        kinds.add("instance")

    def labelled(source: FrameSource) -> LabelledFrame | LeftOut:
        # Pixels are read again only if an arm needs them, or they alone tell the size.
        has_size = source.image is not None and not is_published
        other = replace(source, segmentation=None, others={}) if has_size else source
        try:
            seen = measure_source(source, exact, kinds)
            raw = measure_source(other, naive, ())
        except FilterError as problem:
            return LeftOut(source.key, problem)
        boxes = label_boxes(
            source.key,
            ProjectedBoxes(seen.evidence, _in_image(seen)),
            ProjectedBoxes(raw.evidence, _in_image(raw)),
            _box_truth(seen, source, task),
            configs,
        )
        return LabelledFrame(source, seen.annotation, seen.wh, boxes)

    yield from in_order(labelled, frames, workers)


def _in_image(frame: MeasuredFrame) -> BoxesXYXY:
    """(N, 4) px: the rectangles of 3D boxes, and of 2D boxes as given, in the image."""
    geometry = frame.geometry
    is_2d = np.isnan(geometry.vertices[:, 0, 0])
    inside = np.where(is_2d[:, None], geometry.xyxy, geometry.visible_xyxy)
    return clipped(inside, frame.wh)


def _box_truth(frame: MeasuredFrame, source: FrameSource, task: ArmsTask) -> BoxTruth:
    unknown = np.full(len(frame.ids), NOT_MEASURED)
    if task.truth == "instances":
        channels = frame.evidence.channels
        pixels = unknown if channels is None else channels.instance_pixels
        return truth_of_pixels(pixels, task.least_pixels)
    if task.truth == "reviews":
        words = {answer.box: answer.verdict for answer in source.answers}
        codes = {"keep": OBJECT, "reject": GHOST}
        answers = [codes.get(words.get(box_id, ""), DOUBTFUL) for box_id in frame.ids]
        return BoxTruth(np.array(answers, np.int8), unknown)
    there = task.truth.get(source.key, {})
    doubt = KnownBox(int(DOUBTFUL), NOT_MEASURED)
    boxes = [there.get(box_id, doubt) for box_id in frame.ids]
    columns = np.array(boxes, np.int64).reshape(-1, 2)
    return BoxTruth(columns[:, 0].astype(np.int8), columns[:, 1])


def export_sources(
    frames: Iterable[FrameSource],
    config: FilterConfig,
    *,
    measure: bool = False,
    needs: Collection[Need] = (),
    also: Callable[[Mapping[str, ClassCount], tuple[str, ...]], None] = (
        lambda _classes, _notes: None
    ),
) -> Generator[ExportFrame | LeftOut, None, None]:
    """Frames of a folder, prepared for the writers of formats, in their order.

    Only a few are read ahead; one that cannot be read does not stop the others. With
    `measure`, segmentations are read, so that the filter decides; else all boxes that
    are in the image are ``unmeasured``. Decisions, and columns of them, are only made
    where the format `needs` them. `also` is called with the boxes of each frame,
    counted by class, and its `MeasuredFrame.notes`, in the frames' order.
    """

    def export(
        source: FrameSource,
    ) -> tuple[ExportFrame, Mapping[str, ClassCount], tuple[str, ...]] | LeftOut:
        try:
            return _export_frame(source, config, measure=measure, needs=needs)
        except FilterError as problem:
            return LeftOut(source.key, problem)

    for exported in in_order(export, frames):
        if isinstance(exported, LeftOut):
            yield exported
        else:
            frame, classes, notes = exported
            also(classes, notes)
            yield frame


def _export_frame(
    source: FrameSource, config: FilterConfig, *, measure: bool, needs: Collection[Need]
) -> tuple[ExportFrame, Mapping[str, ClassCount], tuple[str, ...]]:
    """A frame for the writers, its boxes by class, and its notes."""
    # Neither masks nor depth nor LiDAR are needed, so they are not read.
    read = source if measure else replace(source, segmentation=None, others={})
    measured = measure_source(read, config, config.channels)
    verdicts = decide(measured.evidence, config)
    if not measure and measured.evidence.xyxy is not None:
        # The same decisions, but all boxes in the image are `Reason.NO_SEGMENTATION`
        reason = verdicts.reason.copy()
        reason[~np.isnan(measured.evidence.xyxy[:, 0])] = Reason.NO_SEGMENTATION
        verdicts = replace(verdicts, reason=reason)
    annotation = measured.annotation
    boxes = decided_boxes(
        measured.ids,
        measured.evidence,
        verdicts,
        measured.geometry,
        lossy=measured.lossy,
    )
    frame = ExportFrame(
        key=source.key,
        wh=measured.wh,
        boxes=boxes,
        given=GivenAnnotation(lambda: annotation.raw, measured.wh),
        map=annotation.map,
        sequence=annotation.sequence,
        split=annotation.split,
        palette=measured.palette,
    )
    if "decisions" in needs:
        decisions = FrameResult(measured, verdicts, config).decisions
        frame = replace(frame, decisions=decisions)
    if "decision_columns" in needs:
        facts = measured.facts(config)
        columns = decision_columns(facts, measured.evidence, verdicts)
        frame = replace(frame, columns=columns)
    if source.image is not None:
        content = read_file(source.image, "image")
        with file_context("image"):
            media_type = read_image_header(content).media_type
        read_image = partial(read_file, source.image, "image")
        draw = partial(_drawn, source.image)
        frame = replace(frame, read_image=read_image, media_type=media_type, draw=draw)
    if "files" in needs:
        files: dict[str, Path | None] = {**source.others}
        files["segmentation"] = source.segmentation
        files["lidar"] = source.plain_points or files.get("lidar")
        readers: dict[str, Callable[[], bytes]] = {
            kind: partial(read_file, path, kind) for kind, path in files.items() if path
        }
        if read_tags := readers.get("segmentation"):
            reading = SegmentationOptions(
                measured.palette or "auto", carla_version=annotation.carla_version
            )
            readers["segmentation"] = lambda: in_colors(read_tags(), reading)
        frame = replace(frame, read_files=readers)
    return frame, count_by_class(measured.evidence, verdicts), measured.notes


def _drawn(image: Path, boxes: Sequence[DrawnBox]) -> bytes:
    with file_context("image"):
        return png_with_boxes(read_file(image, "image"), boxes)


def class_order(frames: Iterable[FrameSource]) -> tuple[str, ...]:
    """The classes of frames whose layout has no list of classes, in a stable order.

    The filter's own classes come first, in their order, then all others by name. The
    order of the frames and the frequency of a class do not matter.
    """
    return in_class_order(boxes_by_class(frames))


def in_class_order(names: Collection[str]) -> tuple[str, ...]:
    """Names of classes in the order of `class_order`, each once."""
    usual_names = [name for name in CLASSES if name in names]
    return (*usual_names, *sorted(set(names).difference(usual_names)))


def boxes_by_class(frames: Iterable[FrameSource]) -> Counter[str]:
    """How many boxes of each class labels have; no picture is read.

    Frames whose labels cannot be read are left out: who uses the frames reports them.
    """
    counts: Counter[str] = Counter()
    for frame in frames:
        try:
            annotation = parse_annotation(frame.annotation or {}, frame=frame.key)
        except FilterError:
            continue
        counts.update(map(box_class, annotation.boxes))
    return counts


def measure_source(
    source: FrameSource, config: FilterConfig, channels: Collection[str]
) -> MeasuredFrame:
    """Measure one frame of a folder, and decide nothing.

    The configuration's own channels are only measured if they are in `channels`, too.
    Raises `FilterError`: what is wrong with the frame.
    """
    if problem := source.problem or missing_image(source):
        raise problem
    measuring = replace(measuring_of(source, config), channels=()).with_channels(
        channels
    )
    wh = None if source.image is None else _size(source.image, "image")
    if wh is None and source.segmentation is None and "instances" in source.others:
        wh = _size(source.others["instances"], "instances")
    ignore = None
    if "ignore_mask" in source.others and wh is not None:
        content = read_file(source.others["ignore_mask"], "ignore_mask")
        ignore = read_ignore_mask(content, wh)
    sensors = {
        kind: read_file(source.others[kind], kind)
        for kind in files_for(channels)
        if kind in source.others
    }
    tags = None
    if source.segmentation is not None:
        tags = read_file(source.segmentation, "segmentation")
    options = FrameOptions(key=source.key, image_wh=wh, ignore=ignore, sensors=sensors)
    return read_and_measure(source.annotation or {}, tags, measuring, options)


def measuring_of(source: FrameSource, config: FilterConfig) -> MeasureConfig:
    """How a frame is measured: by what its recording shows, if nothing names it."""
    if not source.shown:
        return config.measuring()
    shown = FilterConfig.from_mapping(source.shown)
    measuring = config.measuring(
        SegmentationOptions.named_by(shown), dataset_name="the recording"
    )
    if config.depth_encoding != "auto":
        return measuring
    return replace(measuring, depth_encoding=shown.depth_encoding)


def _size(image: Path, what: str) -> tuple[int, int]:
    """Width and height. The file is mapped, so only pages with its header are read."""
    with opening_file(image, what), file_context(what), open_regular(image) as file:
        if not os.fstat(file.fileno()).st_size:
            return read_image_header(b"").wh
        with mmap(file.fileno(), 0, access=ACCESS_READ) as content:
            return read_image_header(content, whole=False).wh


def in_order(
    work: Callable[[_Given], _Made], items: Iterable[_Given], workers: int | None = None
) -> Generator[_Made, None, None]:
    """Work on many items in threads; the results come in the order of the items.

    Only a few items are read ahead, so there may be any number of them. `workers` is
    the number of threads, by default one more than cores; exceptions of `work` are
    raised here.
    """
    count = workers or (os.cpu_count() or 1) + 1
    waiting: deque[Future[_Made]] = deque()
    with ThreadPoolExecutor(count, thread_name_prefix="filter") as pool:
        try:
            for item in items:
                waiting.append(pool.submit(work, item))
                if len(waiting) >= count * _AHEAD:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            # If the caller stops iterating, frames that have not begun are dropped.
            for future in waiting:
                future.cancel()
