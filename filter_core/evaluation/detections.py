"""Scores a detector's rectangles by COCO's protocol, with bootstrap intervals.

The truth is objects and regions to ignore. `match` assigns detections to them,
`average_precision` scores the matches, for many resamples of the frames at once.

References
----------
.. [1] "COCO detection evaluation", https://cocodataset.org/#detection-eval, and its
   code, ``pycocotools/cocoeval.py``, with which tests compare the scores.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, TypedDict

import numpy as np

from filter_core.arrays import BoolArray, BoxesXYXY, FloatArray, IntArray, rows_of
from filter_core.evaluation.scores import BANDS, band_index
from filter_core.geometry.boxes import pairwise_iou

IOUS: Final[FloatArray] = np.linspace(0.5, 0.95, 10)
"""The overlaps from which a detection can be right."""

_RECALLS: Final[FloatArray] = np.linspace(0.0, 1.0, 101)

_MOST: Final = 100
"""Detections of one class in one frame that count, those of the highest scores."""


@dataclass(frozen=True, eq=False)
class Objects:
    """M objects in the frames of a test set.

    Attributes
    ----------
    frame, label : (M,) int64
        The numbers of its frame and of its class.
    xyxy : (M, 4) float64, px
    ignored : (M,) bool
        Doubtful: neither missing it nor finding it counts.
    distance : (M,) float64, metres, NaN where unknown
    """

    frame: IntArray
    label: IntArray
    xyxy: BoxesXYXY
    ignored: BoolArray
    distance: FloatArray

    def __getitem__(self, rows: BoolArray | IntArray) -> Objects:
        """Some of the objects."""
        return rows_of(self, rows)


@dataclass(frozen=True, eq=False)
class Detections:
    """D detections; attributes as those of `Objects`, and their scores (D,)."""

    frame: IntArray
    label: IntArray
    xyxy: BoxesXYXY
    score: FloatArray

    def __getitem__(self, rows: BoolArray | IntArray) -> Detections:
        """Some of the detections."""
        return rows_of(self, rows)


@dataclass(frozen=True, eq=False)
class Matches:
    """The D detections of one class, the highest score first, and what they match.

    Attributes
    ----------
    row : (D,) int64
        Into the detections that were matched.
    frame : (D,) int64
    score : (D,) float64
    hit, ignored : (T, D) bool
        For T overlaps: whether a detection matches an object; whether it does not
        count, because it matches a doubtful one.
    objects : (F,) int64
        How many objects each of F frames has.
    """

    row: IntArray
    frame: IntArray
    score: FloatArray
    hit: BoolArray
    ignored: BoolArray
    objects: IntArray


def match(
    objects: Objects, detections: Detections, frames: int, ious: FloatArray = IOUS
) -> dict[int, Matches]:
    """Assign detections to objects of their class and frame, as COCO does.

    By class number, for each class with objects or detections.

    Parameters
    ----------
    frames : int
        How many frames there are; `frame` numbers are below it.
    ious : (T,) float64, 0..1
        From which overlap on a detection matches.

    Notes
    -----
    From the highest score on, each detection takes the object that it overlaps most
    and that is not taken; a doubtful one only if there is no other. The doubtful are
    no crowds: one detection takes one of them, by intersection over union.
    """
    labels = np.union1d(objects.label, detections.label).tolist()
    return {
        label: _match_class(
            objects[objects.label == label],
            np.flatnonzero(detections.label == label),
            detections,
            (frames, ious),
        )
        for label in labels
    }


def _match_class(
    objects: Objects,
    rows: IntArray,
    detections: Detections,
    size: tuple[int, FloatArray],
) -> Matches:
    frames, ious = size
    rows = rows[np.lexsort((-detections.score[rows], detections.frame[rows]))]
    # (N,): how many of the same value stand before each of sorted values
    group = detections.frame[rows]
    rank: IntArray = np.arange(len(group)) - np.searchsorted(group, group)
    rows = rows[rank < _MOST]
    frame = detections.frame[rows]
    hit = np.zeros((len(ious), len(rows)), np.bool_)
    ignored = np.zeros_like(hit)
    order = np.argsort(objects.frame, kind="stable")
    of_frame = np.searchsorted(objects.frame[order], np.arange(frames + 1))
    starts = np.searchsorted(frame, np.arange(frames + 1))
    for number in np.unique(frame).tolist():
        there = objects[order[of_frame[number] : of_frame[number + 1]]]
        part = slice(starts[number], starts[number + 1])
        overlap = pairwise_iou(detections.xyxy[rows[part]], there.xyxy)
        hit[:, part], ignored[:, part] = _match_frame(overlap, there.ignored, ious)
    best = np.argsort(-detections.score[rows], kind="stable")
    return Matches(
        row=rows[best],
        frame=frame[best],
        score=detections.score[rows[best]],
        hit=hit[:, best],
        ignored=ignored[:, best],
        objects=np.bincount(objects.frame[~objects.ignored], minlength=frames),
    )


def _match_frame(
    overlap: FloatArray, doubtful: BoolArray, ious: FloatArray
) -> tuple[BoolArray, BoolArray]:
    """(T, D) each: hits and ignored detections of one frame, from (D, M) overlaps."""
    hit = np.zeros((len(ious), len(overlap)), np.bool_)
    ignored = np.zeros_like(hit)
    taken = np.zeros((len(ious), len(doubtful)), np.bool_)
    thresholds = np.minimum(ious, 1 - 1e-10)[:, None]
    for place in np.flatnonzero((overlap >= ious.min()).any(axis=1)).tolist():
        possible = np.where(taken | (overlap[place] < thresholds), -1, overlap[place])
        # Those that are no doubt come first; of equal overlaps the last, as in [1]_.
        possible = np.where(
            doubtful, possible, np.where(possible < 0, -1, possible + 1)
        )
        best = possible.shape[1] - 1 - possible[:, ::-1].argmax(axis=1)
        at = np.flatnonzero(possible[np.arange(len(ious)), best] >= 0)
        taken[at, best[at]] = True
        hit[at, place] = ~doubtful[best[at]]
        ignored[at, place] = doubtful[best[at]]
    return hit, ignored


def average_precision(matches: Matches, weights: FloatArray) -> FloatArray:
    """(R, T) float64, 0..1: the average precision of one class.

    For each of R weightings of frames and each of T overlaps; NaN where there is no
    object. `weights`, (R, F) float64, say how often each of F frames counts; of a
    resample, how often it was drawn.
    """
    averages = np.zeros((len(weights), len(matches.hit)))
    objects = weights @ matches.objects
    for row, (hit, ignored) in enumerate(
        zip(matches.hit, matches.ignored, strict=True)
    ):
        counted = ~ignored
        weight = weights[:, matches.frame[counted]]
        is_hit = hit[counted]
        # Recall rises at hits only, and there precision has its peaks.
        all_so_far = np.cumsum(weight, axis=1)[:, is_hit]
        right_so_far = np.cumsum(weight[:, is_hit], axis=1)
        precision = right_so_far / (all_so_far + np.spacing(1))
        envelope = np.maximum.accumulate(precision[:, ::-1], axis=1)[:, ::-1]
        recall = right_so_far / np.maximum(objects, 1e-9)[:, None]
        reached = np.searchsorted(_RECALLS, recall, side="right")
        steps = np.diff(reached, axis=1, prepend=0)
        averages[:, row] = (steps * envelope).sum(axis=1) / len(_RECALLS)
    averages[objects <= 0] = np.nan
    return averages


def mean_precisions(
    matches: dict[int, Matches], weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(R,) each: mAP at an overlap of 0.5, and over all of `IOUS`.

    The mean is over classes with objects; the parameters are those of
    `average_precision`, for all classes. 0 if no class has objects.
    """
    each = [
        average_precision(class_matches, weights) for class_matches in matches.values()
    ]
    if not each:
        return np.zeros(len(weights)), np.zeros(len(weights))
    stacked = np.stack(each)
    class_count = (~np.isnan(stacked[..., 0])).sum(axis=0)
    total = np.nansum(stacked, axis=0) / np.maximum(class_count, 1)[:, None]
    return total[:, 0], total.mean(axis=1)


class OperatingPoint(NamedTuple):
    """The score with the best F1 over all classes, at an overlap of 0.5.

    `precision` and `recall` (0..1) are those of the detections from that score on.
    """

    score: float
    precision: float
    recall: float


def operating_point(matches: Sequence[Matches]) -> OperatingPoint:
    """The score with the best F1 over all classes, at the first overlap."""
    score = np.concatenate(
        [class_matches.score[~class_matches.ignored[0]] for class_matches in matches]
        or [[]]
    )
    hit = np.concatenate(
        [class_matches.hit[0][~class_matches.ignored[0]] for class_matches in matches]
        or [[]]
    )
    objects = int(sum(class_matches.objects.sum() for class_matches in matches))
    if not len(score) or not objects:
        return OperatingPoint(1.0, 0.0, 0.0)
    order = np.argsort(-score, kind="stable")
    right, count = np.cumsum(hit[order]), np.arange(1, len(order) + 1)
    # Detections of one score count together.
    last = np.append(np.diff(score[order]) != 0, True)
    best = int(np.where(last, 2 * right / (count + objects), -1).argmax())
    return OperatingPoint(
        float(score[order][best]),
        float(right[best] / count[best]),
        float(right[best] / objects),
    )


class DetectionScore(TypedDict):
    """The scores of one detector.

    Precision, recall and false positives are at the operating point. Of the false ones
    per frame, `on_ghosts` overlap a raw label of no visible object by half. Classes
    have ``objects``, ``ap50``, ``ap50_95`` and ``recall``, bands of distance all of
    these but ``ap50_95``. In a band, objects of other bands are ignored; a detection
    has no distance, so false ones count in every band.
    """

    map50: float
    map50_95: float
    precision: float
    recall: float
    false_positives: float
    on_ghosts: float
    by_class: dict[str, dict[str, float]]
    by_distance: dict[str, dict[str, float]]


def score_detections(
    objects: Objects,
    detections: Detections,
    ghosts: Objects,
    classes: Sequence[str],
    frames: int,
) -> DetectionScore:
    """Score one detector against the truth of F frames.

    `ghosts` are raw labels of objects that are not visible; `classes` are by number.
    """
    matches = match(objects, detections, frames)
    every = np.ones((1, frames))
    map50, map50_95 = mean_precisions(matches, every)
    point = operating_point(list(matches.values()))
    false = [
        class_matches.row[
            (class_matches.score >= point.score)
            & ~class_matches.hit[0]
            & ~class_matches.ignored[0]
        ]
        for class_matches in matches.values()
    ]
    rows = np.concatenate([*false, np.empty(0, np.int64)])
    by_class = {}
    for label, class_matches in matches.items():
        if total := int(class_matches.objects.sum()):
            each = average_precision(class_matches, every)[0]
            by_class[classes[label]] = {
                "objects": total,
                "ap50": float(each[0]),
                "ap50_95": float(each.mean()),
                "recall": _hits([class_matches], point.score) / total,
            }
    by_distance = {}
    band = band_index(objects.distance)
    for number, name in enumerate(BANDS):
        own = replace(objects, ignored=objects.ignored | (band != number))
        if total := int((~own.ignored).sum()):
            band_matches = match(own, detections, frames, IOUS[:1])
            by_distance[name] = {
                "objects": total,
                "ap50": float(mean_precisions(band_matches, every)[0][0]),
                "recall": _hits(band_matches.values(), point.score) / total,
            }
    return {
        "map50": float(map50[0]),
        "map50_95": float(map50_95[0]),
        "precision": point.precision,
        "recall": point.recall,
        "false_positives": len(rows) / max(frames, 1),
        "on_ghosts": _count_on(ghosts, detections[rows]) / max(frames, 1),
        "by_class": by_class,
        "by_distance": by_distance,
    }


def _hits(matches: Iterable[Matches], score: float) -> int:
    """How many objects are found, at the first overlap, from a score on."""
    return int(
        sum(
            class_matches.hit[0][class_matches.score >= score].sum()
            for class_matches in matches
        )
    )


def _count_on(ghosts: Objects, detections: Detections) -> int:
    """How many detections overlap a ghost of their class by half."""
    count = 0
    for frame in np.unique(detections.frame).tolist():
        mine = detections[detections.frame == frame]
        there = ghosts[ghosts.frame == frame]
        overlap = pairwise_iou(mine.xyxy, there.xyxy)
        same = mine.label[:, None] == there.label[None]
        count += int(((overlap >= IOUS[0]) & same).any(axis=1).sum())
    return count
