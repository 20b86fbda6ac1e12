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
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from mmap import ACCESS_READ, mmap
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple, TypeVar

import numpy as np

from filter_core.annotation.parsing import parse_annotation
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
from filter_core.evaluation.comparison import (
    COMPARED,
    Evaluation,
    truth_from_instances,
)
from filter_core.evidence.depth import DepthImage, read_depth
from filter_core.evidence_kinds import EvidenceName, files_for
from filter_core.formats.export import ExportFrame, GivenAnnotation
from filter_core.formats.format import Need
from filter_core.formats.reading import (
    FrameSet,
    FrameSource,
    missing_image,
    open_regular,
)
from filter_core.images.header import read_image_header
from filter_core.images.ignore_mask import read_ignore_mask
from filter_core.images.pixels import ChannelOrder
from filter_core.json_text import read_json
from filter_core.pipeline import (
    FrameOptions,
    FrameResult,
    MeasuredFrame,
    box_class,
    read_and_measure,
)
from filter_core.segmentation.codes import ORDERS
from filter_core.segmentation.palettes import (
    PAPER_TABLE,
    UnknownVersion,
    family_of_version,
)
from filter_core.segmentation.reading import SegmentationOptions, read_segmentation
from filter_core.types import (
    REJECTED,
    VERDICT_OF_REASON,
    BoolArray,
    Decisions,
    Evidence,
    IntArray,
    Reason,
)

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
    boxes, rejected : int
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
    key : str
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
    frames: Iterable[FrameSource],
    config: FilterConfig,
    *,
    workers: int | None = None,
) -> Generator[FrameOutcome, None, None]:
    """Decide the boxes of many frames.

    Parameters
    ----------
    frames : iterable of FrameSource
        Only a few frames are read ahead, so it may be of any length.
    config : FilterConfig
    workers : int, optional
        Threads; one more than there are cores. Pixel work runs outside Python's lock,
        and while one thread waits for the lock, another keeps its core at work.

    Yields
    ------
    FrameOutcome
        In the order of the frames; a frame that cannot be used has an error, and the
        others go on.
    """
    return in_order(lambda one: filter_one(one, config), frames, workers)


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

    Attributes
    ----------
    config : FilterConfig
    truth : Truth, or None
        None: an object is visible if its instance has a pixel.
    channels : tuple of EvidenceName
        The kinds of evidence that are compared.
    """

    config: FilterConfig = field(default_factory=FilterConfig)
    truth: Truth | None = None
    channels: tuple[EvidenceName, ...] = COMPARED


@dataclass(frozen=True, eq=False)
class KnownBoxes:
    """The N boxes of one frame whose truth is known.

    Attributes
    ----------
    key : str
        The frame's.
    ids : tuple of N str
    evidence : Evidence of N boxes
    visible : (N,) bool
    """

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

    Parameters
    ----------
    frames : iterable of FrameSource
    task : EvaluationTask
    progress : callable
        Called after each frame, with its `MeasuredFrame.notes`.
    also : callable
        Called with the boxes of known truth of each frame, in the frames' order.
    workers : int, optional
        Threads; one more than there are cores.

    Returns
    -------
    Evaluation
    left_out : list of LeftOut
        Frames that could not be used; the others were counted.
    """
    measured_too = () if task.truth is not None else ("instance",)
    wanted = tuple(dict.fromkeys((*task.channels, *measured_too)))
    evaluation = Evaluation(task.config, task.channels)
    left_out: list[LeftOut] = []

    def measured(source: FrameSource) -> MeasuredFrame | LeftOut:
        try:
            return measure_source(source, task.config, wanted)
        except FilterError as problem:
            return LeftOut(source.key, problem)

    for frame in in_order(measured, frames, workers):
        if isinstance(frame, LeftOut):
            left_out.append(frame)
        else:
            boxes = _known(frame, task.truth)
            if len(boxes.ids):
                evaluation.add(boxes.evidence, boxes.visible, name_of=boxes.name_of)
                also(boxes)
        progress(() if isinstance(frame, LeftOut) else frame.notes)
    return evaluation, left_out


def _known(frame: MeasuredFrame, truth: Truth | None) -> KnownBoxes:
    if truth is None:
        rows, visible = truth_from_instances(frame.evidence)
    else:
        rows, visible = _told(truth.get(frame.key, {}), frame.ids)
    ids = tuple(frame.ids[row] for row in rows.tolist())
    return KnownBoxes(frame.key, ids, frame.evidence.take(rows), visible)


def _told(told: Mapping[str, bool], ids: tuple[str, ...]) -> tuple[IntArray, BoolArray]:
    rows = [row for row, box_id in enumerate(ids) if box_id in told]
    visible = [told[ids[row]] for row in rows]
    return np.array(rows, np.int64), np.array(visible, np.bool_)


def read_truth(path: Path) -> dict[str, dict[str, bool]]:
    """Reads lines of ``{"key", "id", "visible"}``; other keys are ignored.

    Raises
    ------
    LayoutError
        Names the line and its error.
    """
    truth: dict[str, dict[str, bool]] = {}
    for number, line in _lines(path):
        try:
            given = read_json(line)
            if not isinstance(given, dict):
                raise TypeError(f"{type(given).__name__} is not an object")
            key, box_id, visible = given["key"], given["id"], given["visible"]
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
    """Each line that is not empty, with its number."""
    try:
        with path.open(encoding="utf-8") as file:
            lines = iter(lambda: file.readline(_MAX_LINE), "")
            yield from ((at, line) for at, line in enumerate(lines, 1) if line.strip())
    except (OSError, UnicodeDecodeError) as error:
        raise LayoutError(f"{path.name} cannot be read as UTF-8 lines") from error


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
    """Frames of a folder, prepared for the writers of formats.

    Parameters
    ----------
    frames : iterable of FrameSource
        Read only a few frames ahead.
    config : FilterConfig
    measure : bool
        Read the segmentations, so that the filter decides; else all boxes that are in
        the image are ``unmeasured``.
    needs : collection of `Need`
        Of the format: decisions, and columns of them, are only made where it needs
        them.
    also : callable
        Called with the boxes of each frame, counted by class, and its
        `MeasuredFrame.notes`, in the frames' order.

    Yields
    ------
    ExportFrame or LeftOut
        In the order of the frames; one that cannot be read does not stop the others.
    """

    def export(source: FrameSource) -> _Exported | LeftOut:
        try:
            return _export_frame(source, config, measure=measure, needs=needs)
        except FilterError as problem:
            return LeftOut(source.key, problem)

    for exported in in_order(export, frames):
        if isinstance(exported, LeftOut):
            yield exported
        else:
            also(exported.classes, exported.notes)
            yield exported.frame


class _Exported(NamedTuple):
    """A frame for the writers, its boxes by class, and its notes."""

    frame: ExportFrame
    classes: Mapping[str, ClassCount]
    notes: tuple[str, ...]


def _export_frame(
    source: FrameSource,
    config: FilterConfig,
    *,
    measure: bool,
    needs: Collection[Need],
) -> _Exported:
    # Neither masks nor depth nor LiDAR are needed, so they are not read.
    read = source if measure else replace(source, segmentation=None, others={})
    measured = measure_source(read, config, config.channels)
    verdicts = decide(measured.evidence, config)
    if not measure:
        verdicts = _without_verdicts(measured.evidence, verdicts)
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
        content = _read(source.image, "image")
        with file_context("image"):
            media_type = read_image_header(content).media_type
        read_image = partial(_read, source.image, "image")
        frame = replace(frame, read_image=read_image, media_type=media_type)
    classes = count_by_class(measured.evidence, verdicts)
    return _Exported(frame, classes, measured.notes)


def _without_verdicts(evidence: Evidence, verdicts: Decisions) -> Decisions:
    """The same decisions, but all boxes in the image are `Reason.NO_SEGMENTATION`."""
    if evidence.xyxy is None:
        return verdicts
    reason = verdicts.reason.copy()
    reason[~np.isnan(evidence.xyxy[:, 0])] = Reason.NO_SEGMENTATION
    return replace(verdicts, reason=reason)


def class_order(frames: Iterable[FrameSource]) -> tuple[str, ...]:
    """The classes of frames whose layout has no list of classes, in a stable order.

    The filter's own classes come first, in their order, then all others by name. The
    order of the frames and the frequency of a class do not matter.
    """
    return in_class_order(boxes_by_class(frames))


def in_class_order(names: Collection[str]) -> tuple[str, ...]:
    """Names of classes in the order of `class_order`, each once."""
    known = [name for name in CLASSES if name in names]
    return (*known, *sorted(set(names).difference(known)))


def boxes_by_class(frames: Iterable[FrameSource]) -> Counter[str]:
    """How many boxes of each class labels have; no picture is read.

    Frames whose labels cannot be read are left out: who uses the frames reports them.
    """
    found: Counter[str] = Counter()
    for frame in frames:
        try:
            annotation = parse_annotation(frame.annotation or {}, frame=frame.key)
        except FilterError:
            continue
        found.update(map(box_class, annotation.boxes))
    return found


_DEPTH_IMAGES: Final = 8
"""Depth images of a recording that are looked at."""

_FEWEST_LOOKED_AT: Final = 3

_LOOKED_AT_SHARE: Final = 40
"""Of so many segmentations of a recording, one is looked at, but some at least."""

_MOST_TIMES: Final = 4
"""So many times more are looked at while they do not tell the family of tags."""


class Shown(NamedTuple):
    """What the images of a recording show about how they are read.

    Attributes
    ----------
    keys : mapping of str to str
        Keys of a configuration with their values.
    notes : tuple of str
        Sentences for people: what was recognised, and how sure it is.
    """

    keys: Mapping[str, str] = MappingProxyType({})
    notes: tuple[str, ...] = ()

    def of(self, frames: FrameSet) -> FrameSet:
        """The frames, which are read so, unless they name their own version."""
        return replace(frames, frames=lambda: map(self.of_frame, frames))

    def of_frame(self, frame: FrameSource) -> FrameSource:
        """One of these frames."""
        keys = dict(self.keys)
        if "palette" in keys and _family_by_version(frame):
            del keys["palette"]
        return replace(frame, shown=keys) if keys else frame


def recognise_recording(
    frames: Iterable[FrameSource],
    config: FilterConfig,
    channels: Collection[str] = (),
) -> Shown:
    """How the images of a recording are read, by some of them together.

    Parameters
    ----------
    frames : iterable of FrameSource
        Some of the recording. A few of their images are read.
    config : FilterConfig
        What it names is not recognised.
    channels : collection of EvidenceName
        What is measured besides the segmentation.

    Raises
    ------
    LayoutError
        ``several_families``: images prove different families of tags.

    Notes
    -----
    A recording has one family of tags and one encoding of depth, and not every image
    shows them: many colours have the same name in all families, and a wall that fills
    an image of depth is too flat. What none of the images shows is left to each frame.
    """
    several = list(frames)
    depth = _shown_depth(several, config, channels)
    keys, notes = _shown_family(several, config)
    return Shown({**keys, **depth}, notes)


def _shown_depth(
    frames: Iterable[FrameSource], config: FilterConfig, channels: Collection[str]
) -> dict[str, str]:
    """The encoding of depth, if images show one and no other."""
    if config.depth_encoding != "auto" or "depth" not in files_for(channels):
        return {}
    shown = {
        depth.encoding
        for _, depth in depth_images(frames)
        # A fault is said when the frame is used.
        if isinstance(depth, DepthImage) and depth.is_certain
    }
    return {"depth_encoding": shown.pop()} if len(shown) == 1 else {}


def depth_images(
    frames: Iterable[FrameSource],
) -> Iterator[tuple[str, DepthImage | FilterError]]:
    """A few depth images of some frames: the frame's key, and the image or its fault.

    Each is read as it shows itself, whatever others show.
    """
    there = [frame for frame in frames if "depth" in frame.others]
    step = max(1, len(there) // _DEPTH_IMAGES)
    for frame in there[::step][:_DEPTH_IMAGES]:
        try:
            yield frame.key, read_depth(_read(frame.others["depth"], "depth"))
        except FilterError as fault:
            yield frame.key, fault


class _Vote(NamedTuple):
    """What the segmentation of a frame tells: families, and with orders of channels.

    The paper's table is only among them if no version of CARLA is.
    """

    key: str
    families: frozenset[str]
    readings: frozenset[tuple[str, ChannelOrder]]


def _shown_family(
    frames: Iterable[FrameSource], config: FilterConfig
) -> tuple[dict[str, str], tuple[str, ...]]:
    """The palette, if images tell it; the order of channels, if swapped; and notes."""
    if config.palette != "auto":
        return {}, ()
    images = [
        frame
        for frame in frames
        if frame.segmentation and not frame.problem and not _family_by_version(frame)
    ]
    fewest = min(len(images), max(_FEWEST_LOOKED_AT, len(images) // _LOOKED_AT_SHARE))
    votes: list[_Vote] = []
    common: frozenset[str] = frozenset()
    for number, frame in enumerate(_spread(images, fewest)):
        if len(common) == 1 and number >= fewest:
            break
        if vote := _vote(frame, config):
            votes.append(vote)
            common = _common(votes)
    if len(common) != 1:
        return {}, ()
    (family,) = common
    orders = frozenset(ORDERS).intersection(
        *({order for one, order in vote.readings if one == family} for vote in votes)
    )
    telling = sum(vote.families == common for vote in votes)
    note = (
        f"tags of {family}: told by {telling or 'none'} of the {len(votes)} "
        f"segmentations that were looked at{'' if telling else ' alone, but together'}"
    )
    swapped = {"channel_order": "bgr"} if orders == {"bgr"} else {}
    return {"palette": family, **swapped}, (note,)


def _spread(images: Sequence[FrameSource], fewest: int) -> Iterator[FrameSource]:
    """Some images in an order in which any number of them is spread over all."""
    most = min(len(images), fewest * _MOST_TIMES)
    places = [
        place
        for count in (fewest, most)
        for place in np.linspace(0, len(images) - 1, count).astype(int).tolist()
    ]
    return (images[place] for place in dict.fromkeys(places))


def _family_by_version(frame: FrameSource) -> str | None:
    """The family of the version of CARLA that a frame names, if it is known."""
    version = (frame.annotation or {}).get("carla_version")
    try:
        return family_of_version(version) if isinstance(version, str) else None
    except UnknownVersion:
        return None


def _vote(frame: FrameSource, config: FilterConfig) -> _Vote | None:
    try:
        content = _segmentation(frame) or b""
        found = read_segmentation(content, config.measuring().reading)
    except FilterError:
        return None  # said when the frame is used, unless others tell its family
    families = frozenset(family for family, _ in found.readings)
    return _Vote(frame.key, families - {PAPER_TABLE} or families, found.readings)


def _common(votes: Sequence[_Vote]) -> frozenset[str]:
    """The families that fit all images.

    Raises
    ------
    LayoutError
        There is none.
    """
    # CARLA does not render the paper's table, so that others can explain such an image.
    usual = [vote for vote in votes if vote.families != {PAPER_TABLE}] or votes
    common = frozenset.intersection(*(vote.families for vote in usual))
    if common:
        return common
    *before, last = usual
    other = min(before, key=lambda vote: len(vote.families & last.families))
    one, two = (
        f"{vote.key} is of {' or '.join(sorted(vote.families))}"
        for vote in (other, last)
    )
    raise LayoutError(
        f"expected segmentations of one family of tags, found several: {one}, {two}. "
        "Read recordings of different versions of CARLA apart, or give their frames a "
        "carla_version; --palette names the family if one of these is wrong",
        code="several_families",
    )


def measure_source(
    source: FrameSource, config: FilterConfig, channels: Collection[str]
) -> MeasuredFrame:
    """Measure one frame of a folder, and decide nothing.

    Parameters
    ----------
    source : FrameSource
    config : FilterConfig
        Its own channels are only measured if they are in `channels`, too.
    channels : collection of EvidenceName

    Raises
    ------
    FilterError
        What is wrong with the frame.
    """
    if problem := source.problem or missing_image(source):
        raise problem
    measuring = replace(measuring_of(source, config), channels=()).with_channels(
        channels
    )
    options = _frame_options(source, files_for(channels))
    return read_and_measure(
        source.annotation or {}, _segmentation(source), measuring, options
    )


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


def _frame_options(source: FrameSource, kinds: Iterable[str]) -> FrameOptions:
    wh = None if source.image is None else _size(source.image, "image")
    if wh is None and source.segmentation is None and "instances" in source.others:
        wh = _size(source.others["instances"], "instances")
    ignore = None
    if "ignore_mask" in source.others and wh is not None:
        content = _read(source.others["ignore_mask"], "ignore_mask")
        ignore = read_ignore_mask(content, wh)
    sensors = {
        kind: _read(source.others[kind], kind)
        for kind in kinds
        if kind in source.others
    }
    return FrameOptions(key=source.key, image_wh=wh, ignore=ignore, sensors=sensors)


def _segmentation(source: FrameSource) -> bytes | None:
    if source.segmentation is None:
        return None
    return _read(source.segmentation, "segmentation")


def _size(image: Path, what: str) -> tuple[int, int]:
    """Width and height. The file is mapped, so only pages with its header are read."""
    with _opening(image, what), file_context(what), open_regular(image) as file:
        if not os.fstat(file.fileno()).st_size:
            return read_image_header(b"").wh
        with mmap(file.fileno(), 0, access=ACCESS_READ) as content:
            return read_image_header(content, whole=False).wh


def _read(path: Path, what: str) -> bytes:
    with _opening(path, what), open_regular(path) as file:
        return file.read()


@contextmanager
def _opening(path: Path, what: str) -> Iterator[None]:
    try:
        yield
    except OSError as exc:
        raise LayoutError(
            f"{what}: {path.name} cannot be read: {exc.strerror}"
        ) from exc


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
