"""A folder's channels compared with the truth, without a server."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from filter_core.channel_types import NOT_MEASURED
from filter_core.config.filter import FilterConfig
from filter_core.errors import FilterError, LayoutError
from filter_core.evaluation.comparison import COMPARED, Evaluation
from filter_core.formats.reading import FrameSource
from filter_core.json_text import read_json
from filter_core.local import in_order, measure_source, problem_of
from filter_core.pipeline import MeasuredFrame
from filter_core.segmentation.reading import SegmentationOptions
from filter_core.types import BoolArray, Evidence, IntArray

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
