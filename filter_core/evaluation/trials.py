"""Compares the detectors of an experiment: differences between arms, with intervals.

A *trial* is one detector, trained on one arm with one seed, and what it detects in a
*test set*. Trials of one seed and test set differ in the labels only, so differences
are taken in pairs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import fmean
from typing import Final, NamedTuple, TypedDict

import numpy as np

from filter_core.arrays import BoxesXYXY, FloatArray, IntArray
from filter_core.evaluation.detections import (
    IOUS,
    Detections,
    DetectionScore,
    Objects,
    match,
    mean_precisions,
    score_detections,
)
from filter_core.evaluation.scores import Measured, MeasuredObject

_ROLES: Final = {"perfect": " (ceiling)", "random": " (control)"}
"""Arms that nobody can have, or would want."""

_RESAMPLES: Final = 400

_AT_A_TIME: Final = 50
"""Resamples of one detector that are scored at the same time."""

_SEED: Final = 2026

_FEWEST_DRIVES: Final = 8
"""With fewer drives in a test set, single frames are drawn instead."""


@dataclass(frozen=True, eq=False)
class EvaluationSet:
    """The truth that all arms are scored against.

    `tight_xyxy` (M, 4), px, are the rectangles around the visible pixels of the
    objects; NaN where unknown. `ghosts` are raw labels of objects that are not visible,
    and `drive` (F,) has a number for the drive of each frame.
    """

    name: str
    classes: tuple[str, ...]
    objects: Objects
    tight_xyxy: BoxesXYXY
    ghosts: Objects
    drive: IntArray

    @property
    def frames(self) -> int:
        """How many there are."""
        return len(self.drive)

    @property
    def drawn(self) -> IntArray:
        """(F,) int64: what a resample draws as a whole: the drive, or the frame.

        Frames of one drive show the same objects, so they tell less than as many
        others.
        """
        drives = np.unique(self.drive, return_inverse=True)[1]
        few = drives.max(initial=-1) + 1 < _FEWEST_DRIVES
        return np.arange(self.frames) if few else drives


class TrialKey(NamedTuple):
    """Which trial: its test set by number, its arm and its seed."""

    test: int
    arm: str
    seed: int


@dataclass(frozen=True, eq=False)
class Trial:
    """What a detector detects in a test set; `own` are the arm's labels there."""

    key: TrialKey
    detections: Detections
    own: Objects


class SeededObject(MeasuredObject):
    """A number with its interval, and its values by seed."""

    by_seed: dict[str, float]


class ArmScore(TypedDict):
    """The scores of an arm: means over its trials.

    `means` are those of numbers of `DetectionScore`, and ``tight_map50`` against the
    rectangles around visible pixels, ``own_map50`` against the arm's own labels.
    """

    trials: int
    map50: SeededObject
    map50_95: SeededObject
    means: dict[str, float]
    by_class: dict[str, dict[str, float]]
    by_distance: dict[str, dict[str, float]]


class DifferenceObject(SeededObject):
    """How much better an arm is than the baseline, and whether that is shown.

    It is shown if the interval does not contain 0, and if there are several seeds,
    which all agree.
    """

    shown: bool


class ComparisonObject(TypedDict):
    """A comparison of arms as JSON."""

    baseline: str
    tests: list[str]
    seeds: list[int]
    arms: dict[str, ArmScore]
    differences: dict[str, dict[str, DifferenceObject]]
    verdict: str


def compare(
    tests: Sequence[EvaluationSet],
    trials: Iterable[Trial],
    progress: Callable[[int], None] = lambda _: None,
) -> ComparisonObject:
    """Score trials, and compare each arm with the first: the baseline.

    A trial is needed only while it is scored; `progress` is then called with the number
    of those that have been scored.

    Notes
    -----
    Scores are means over seeds, then over test sets. Intervals are the percentile
    bootstrap: each resample draws drives (or frames) of a test set, the same for all
    arms, and then seeds, both with replacement.
    """
    weights = [_weights(test, number) for number, test in enumerate(tests)]
    scores: dict[str, list[tuple[DetectionScore, dict[str, float]]]] = {}
    # (1 + R, 2) each: mAP50 and mAP50-95, first of all frames, then of each resample
    values: dict[TrialKey, FloatArray] = {}
    for trial in trials:
        test = trial.key.test
        score, means, values[trial.key] = _score(trial, tests[test], weights[test])
        scores.setdefault(trial.key.arm, []).append((score, means))
        progress(len(values))
    arms = list(scores)
    differences = {
        arm: {
            "map50": _difference(values, arm, arms[0], 0),
            "map50_95": _difference(values, arm, arms[0], 1),
        }
        for arm in arms[1:]
    }
    return {
        "baseline": arms[0],
        "tests": [test.name for test in tests],
        "seeds": sorted({key.seed for key in values}),
        "arms": {
            arm: _arm_score(
                own, {key: both for key, both in values.items() if key.arm == arm}
            )
            for arm, own in scores.items()
        },
        "differences": differences,
        "verdict": verdict(arms[0], differences),
    }


def _weights(test: EvaluationSet, number: int) -> FloatArray:
    """(1 + R, F) float64: how often each frame counts: once, then as it is drawn."""
    unit = test.drawn
    count = int(unit.max(initial=-1)) + 1
    rng = np.random.default_rng([_SEED, number])
    shares = np.full(count, 1 / max(count, 1))
    drawn = rng.multinomial(count, shares, size=_RESAMPLES)[:, unit]
    return np.concatenate([np.ones((1, test.frames)), drawn])


def _score(
    trial: Trial, test: EvaluationSet, weights: FloatArray
) -> tuple[DetectionScore, dict[str, float], FloatArray]:
    """The scores of a trial, the `means` of its `ArmScore`, and (1 + R, 2) mAPs."""
    detections, frames = trial.detections, test.frames
    matches = match(test.objects, detections, frames)
    parts = [
        np.stack(mean_precisions(matches, weights[start : start + _AT_A_TIME]), axis=1)
        for start in range(0, len(weights), _AT_A_TIME)
    ]
    score = score_detections(
        test.objects, detections, test.ghosts, test.classes, frames
    )
    has_tight = ~np.isnan(test.tight_xyxy[:, 0])
    tight = replace(test.objects[has_tight], xyxy=test.tight_xyxy[has_tight])

    def map50(objects: Objects) -> float:
        matches = match(objects, detections, frames, IOUS[:1])
        return float(mean_precisions(matches, weights[:1])[0][0])

    means = {
        "precision": score["precision"],
        "recall": score["recall"],
        "tight_map50": map50(tight),
        "own_map50": map50(trial.own),
        "false_positives": score["false_positives"],
        "on_ghosts": score["on_ghosts"],
    }
    return score, means, np.concatenate(parts)


def _interval(values: Mapping[TrialKey, FloatArray]) -> SeededObject:
    """The mean over test sets of the mean over seeds, of (1 + R,) numbers each."""
    rng = np.random.default_rng(_SEED)
    tests = sorted({key.test for key in values})
    total = np.zeros(1 + _RESAMPLES)
    for test in tests:
        own = np.stack(
            [numbers for key, numbers in values.items() if key.test == test], axis=1
        )
        drawn = rng.integers(0, own.shape[1], own.shape)
        drawn[0] = np.arange(own.shape[1])  # the first row is no resample
        total += np.take_along_axis(own, drawn, axis=1).mean(axis=1) / len(tests)
    low, high = np.quantile(total[1:], [0.025, 0.975]).tolist()
    by_seed = {
        str(seed): fmean(
            float(numbers[0]) for key, numbers in values.items() if key.seed == seed
        )
        for seed in sorted({key.seed for key in values})
    }
    return {**Measured(float(total[0]), low, high).as_dict(), "by_seed": by_seed}


def _difference(
    values: Mapping[TrialKey, FloatArray], arm: str, baseline: str, column: int
) -> DifferenceObject:
    pairs = {
        key: both[:, column] - values[base][:, column]
        for key, both in values.items()
        if key.arm == arm and (base := key._replace(arm=baseline)) in values
    }
    if not pairs:
        nothing = Measured(0.0, 0.0, 0.0).as_dict()
        return {**nothing, "by_seed": {}, "shown": False}
    seeded = _interval(pairs)
    signs = {np.sign(difference) for difference in seeded["by_seed"].values()}
    is_apart = seeded["low"] > 0 or seeded["high"] < 0
    several = len(seeded["by_seed"]) > 1
    return {**seeded, "shown": bool(is_apart and several and len(signs) == 1)}


def _arm_score(
    scores: Sequence[tuple[DetectionScore, dict[str, float]]],
    values: Mapping[TrialKey, FloatArray],
) -> ArmScore:
    """The score of an arm from those of its trials.

    `values` are (1 + R, 2): mAP50 and mAP50-95 of all frames, then of each resample.
    Other numbers are means over the trials.
    """
    return {
        "trials": len(scores),
        "map50": _interval({key: both[:, 0] for key, both in values.items()}),
        "map50_95": _interval({key: both[:, 1] for key, both in values.items()}),
        "means": _means([means for _, means in scores]),
        "by_class": _means_of_parts([score["by_class"] for score, _ in scores]),
        "by_distance": _means_of_parts([score["by_distance"] for score, _ in scores]),
    }


def _means(rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """The mean of each number."""
    return {name: fmean(row[name] for row in rows) for name in rows[0]}


def _means_of_parts(
    scores: Sequence[Mapping[str, Mapping[str, float]]],
) -> dict[str, dict[str, float]]:
    """The means of each part, such as a class, over the trials that have it."""
    names = dict.fromkeys(name for score in scores for name in score)
    return {
        name: _means([score[name] for score in scores if name in score])
        for name in names
    }


def verdict(
    baseline: str, differences: Mapping[str, Mapping[str, DifferenceObject]]
) -> str:
    """One sentence: in which arms the detector is better or worse, and where not."""
    said: dict[str, list[str]] = {"better": [], "worse": [], "no difference shown": []}
    for arm, both in differences.items():
        difference = both["map50"]
        title = "better" if difference["value"] > 0 else "worse"
        said[title if difference["shown"] else "no difference shown"].append(
            f"{arm}{_ROLES.get(arm, '')} {difference['value']:+.3f} "
            f"({difference['low']:+.3f} to {difference['high']:+.3f})"
        )
    parts = [f"{title}: {', '.join(arms)}" for title, arms in said.items() if arms]
    if not parts:
        return f"There is no arm to compare with {baseline}."
    return f"mAP50 against {baseline}: {'; '.join(parts)}."
