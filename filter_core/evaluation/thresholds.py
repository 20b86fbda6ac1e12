"""Suggests the best threshold per class from boxes of known truth, with an interval.

`suggest` finds the threshold of one class from the matches of its boxes and whether
each should be kept. `suggest_per_class` does so for every class of boxes that were
decided under a configuration (`Judged`); `TruthCollector` collects those frame by
frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import astuple, dataclass, field, fields, replace
from typing import Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import BoolArray, FloatArray, IntArray, rows_of
from filter_core.class_names import canonical_class
from filter_core.config.declaration import INHERIT
from filter_core.config.filter import ClassConfig, FilterConfig
from filter_core.decisions.channel_rules import own_percent
from filter_core.decisions.rules import decide
from filter_core.evaluation.scores import Confusion
from filter_core.evidence_numbers import Evidence
from filter_core.verdicts import UNMEASURED, VERDICT_OF_REASON, Reason

Target: TypeAlias = Literal["f1", "recall"]
"""The goal for which a threshold is optimised."""

_RESAMPLES: Final = 200
"""Bootstrap resamples for the interval."""

_SEED: Final = 0
"""Of the resamples: the same answers always give the same interval."""

_MOST_VALUES: Final = 256
"""Groups of matches in resamples: much finer than intervals are wide."""

_MAX_PERCENT: Final = 100.0

_MOST_DECIMALS: Final = 6
"""Most decimals of a suggested threshold; used if fewer cannot separate matches."""

_GRID: Final = np.concatenate([np.arange(0, 10, 0.5), np.arange(10, 101, 1.0)])
"""Thresholds of the curve, in percent; finer below 10, where thin objects need it."""

_BY_THRESHOLD: Final = (Reason.VISIBLE, Reason.BELOW_THRESHOLD)
"""The reasons of small boxes that the suggested threshold decides between."""


@dataclass(frozen=True)
class Answers:
    """Answered boxes of one class, those that its threshold decides and the others.

    Attributes
    ----------
    match : (N,) float64, percent
    keep : (N,) bool
        Whether people said keep.
    others : Confusion
        Answered boxes of the class that the threshold does not decide: large ones,
        those outside the image and so on. They count in every score.
    strict : bool
        A match equal to the threshold is rejected (profile ``carlasimu``).
    class_name, key : str
        The class, and the key of a configuration that the threshold is for.
    """

    match: FloatArray
    keep: BoolArray
    others: Confusion = field(default_factory=Confusion)
    strict: bool = False
    class_name: str = ""
    key: str = ""

    def __len__(self) -> int:
        return len(self.match) + self.others.boxes


@dataclass(frozen=True)
class Goal:
    """The goal for which a threshold is chosen.

    ``f1`` is the highest F1, ``recall`` the highest threshold that keeps at least the
    share `recall`, 0..1, of what people keep.
    """

    target: Target = "f1"
    recall: float = 0.99


@dataclass(frozen=True)
class Point:
    """The scores, 0..1, of one threshold, percent.

    None where nothing is kept, or nothing is to be kept.
    """

    threshold: float
    precision: float | None
    recall: float | None
    f1: float | None


@dataclass(frozen=True)
class Suggestion:
    """The best threshold of a class for a goal, with its 95 % interval and scores.

    The scores are those of the threshold in use and of the suggested one, and a curve
    from the lowest threshold to the highest.

    Attributes
    ----------
    key : str
        The key of a configuration that it is for: ``threshold_small_box`` of boxes that
        tags decide, ``min_visible_percent`` of those that a channel decides.
    boxes : int
        Boxes of known truth that it was found from.
    threshold, interval : float, percent
    """

    class_name: str
    key: str
    boxes: int
    threshold: float
    interval: tuple[float, float]
    at_current: Point
    at_suggested: Point
    curve: list[Point]

    def as_dict(self) -> dict[str, object]:
        """Ready for JSON."""
        return {
            "class": self.class_name,
            "key": self.key,
            "current": self.at_current.threshold,
            "suggested": self.threshold,
            "interval": list(self.interval),
            "answers": self.boxes,
            "f1_current": self.at_current.f1,
            "f1_suggested": self.at_suggested.f1,
            "curve": [dict(vars(point)) for point in self.curve],
        }


def suggest(answers: Answers, current: float, goal: Goal) -> Suggestion | None:
    """The best threshold for a goal, judged by what people answered.

    None unless people both kept and rejected boxes that the threshold decides. The
    `current` threshold, percent, is kept if none is better; of several best ones, the
    nearest to it is taken.

    Notes
    -----
    All thresholds between the same two neighbouring matches give the same verdicts, so
    one per gap is scored, from cumulative sums. The interval is the percentile
    bootstrap [1]_ of this choice: as many answers are drawn with replacement and the
    choice is repeated. For that, more than 256 different matches are put into 256
    groups.

    References
    ----------
    .. [1] B. Efron, R. J. Tibshirani, "An Introduction to the Bootstrap", 1993,
       chapter 13.
    """
    if not answers.keep.any() or answers.keep.all():
        return None
    cuts = _Cuts(answers, current)
    chosen = cuts.threshold(int(cuts.best(cuts.counts[None], goal)[0]))
    # The answers, with matches grouped into at most `_MOST_VALUES` values
    values = cuts.values
    if len(values) <= _MOST_VALUES:
        grouped = answers
    else:
        first = values[np.arange(_MOST_VALUES) * len(values) // _MOST_VALUES]
        group = np.searchsorted(first, answers.match, side="right") - 1
        grouped = replace(answers, match=first[group])
    groups = _Cuts(grouped, current)
    drawn = np.random.default_rng(_SEED).multinomial(
        len(answers), groups.counts / len(answers), size=_RESAMPLES
    )
    best, times = np.unique(groups.best(drawn, goal), return_counts=True)
    thresholds = [groups.threshold(cut) for cut in best.tolist()]
    low, high = np.quantile(np.repeat(thresholds, times), [0.025, 0.975]).tolist()
    at_current, at_chosen = cuts.points(np.array([current, chosen]))
    return Suggestion(
        answers.class_name,
        answers.key,
        len(answers),
        chosen,
        (min(low, chosen), max(high, chosen)),
        at_current,
        at_chosen,
        cuts.points(np.unique(np.concatenate([_GRID, [current, chosen]]))),
    )


class _Cuts:
    """Thresholds as cuts of the sorted matches: cut c rejects the c lowest values."""

    def __init__(self, answers: Answers, current: float) -> None:
        self.values, index = np.unique(answers.match, return_inverse=True)
        self._strict, self._current = answers.strict, current
        # (2 M + 4,): reject and keep answers per value, then the fields of `others`
        values = len(self.values)
        cell = index.reshape(-1) + values * answers.keep
        counted = np.bincount(cell, minlength=2 * values)
        self.counts = np.concatenate([counted, astuple(answers.others)])
        self._scores = self.scores(self.counts[None])
        self.at_current = self.cut(current)
        # Thresholds are 0..100, so the first or last cut may be impossible.
        at_zero = answers.strict and self.values[0] <= 0
        at_most = not answers.strict and self.values[-1] >= _MAX_PERCENT
        self._possible = slice(int(at_zero), len(self.values) + 1 - int(at_most))

    def scores(self, counts: IntArray) -> tuple[IntArray, IntArray, IntArray]:
        """(R, M + 1) each: rightly kept, wrongly kept, wrongly rejected per cut."""
        size = len(self.values)
        rejects = _before(counts[:, :size])
        keeps = _before(counts[:, size : 2 * size])
        fixed = counts[:, 2 * size :]
        right = keeps[:, -1:] - keeps + fixed[:, 0:1]
        wrong = rejects[:, -1:] - rejects + fixed[:, 1:2]
        return right, wrong, keeps + fixed[:, 2:3]

    def best(self, counts: IntArray, goal: Goal) -> IntArray:
        """(R,): the best cut of each row of counts."""
        right, wrong, lost = self.scores(counts)
        cuts = np.arange(right.shape[1])
        if goal.target == "recall":
            enough = right >= goal.recall * (right + lost)
            value: NDArray[np.float64] = np.where(enough, cuts, -cuts - 1.0)
        else:
            value = 2.0 * right / np.maximum(2 * right + wrong + lost, 1)
        value = value[:, self._possible]
        first = self._possible.start
        # Of the best cuts, the nearest to the current one.
        good = value >= value.max(axis=1, keepdims=True) - 1e-12
        away = np.abs(cuts[self._possible] - self.at_current)
        nearest: IntArray = np.where(good, away, len(cuts) + 1).argmin(axis=1)
        return nearest + first

    def cut(self, threshold: float) -> int:
        """The cut that a threshold makes."""
        return int(self.cuts_of(np.array(threshold)))

    def cuts_of(self, thresholds: FloatArray) -> NDArray[np.intp]:
        """The cuts that thresholds make, in their shape."""
        side: Literal["left", "right"] = "right" if self._strict else "left"
        return np.asarray(self.values.searchsorted(thresholds, side=side))

    def threshold(self, cut: int) -> float:
        """A threshold that makes a cut, with as few decimals as possible."""
        if cut == self.at_current:
            return self._current
        low = float(self.values[cut - 1]) if cut else 0.0
        high = float(self.values[cut]) if cut < len(self.values) else _MAX_PERCENT
        middle = (low + high) / 2
        for decimals in range(_MOST_DECIMALS + 1):
            rounded = round(middle, decimals)
            if low < rounded < high and self.cut(rounded) == cut:
                return rounded
        return low if self._strict else high

    def points(self, thresholds: FloatArray) -> list[Point]:
        """The scores of each threshold."""
        cuts = self.cuts_of(thresholds)
        counts = (column[0, cuts].tolist() for column in self._scores)
        return [
            Point(
                threshold,
                right / (right + wrong) if right + wrong else None,
                right / (right + lost) if right + lost else None,
                2 * right / (2 * right + wrong + lost)
                if right + wrong + lost
                else None,
            )
            for threshold, right, wrong, lost in zip(
                thresholds.tolist(), *counts, strict=True
            )
        ]


def _before(counts: IntArray) -> IntArray:
    """(R, M + 1): sums of the first 0, 1, .. M columns."""
    sums = np.zeros((len(counts), counts.shape[1] + 1), np.int64)
    np.cumsum(counts, axis=1, out=sums[:, 1:])
    return sums


@dataclass(frozen=True, eq=False)
class Judged:
    """N decided boxes, with the truth of each.

    Attributes
    ----------
    class_key : (N,) int64
        The number of each box's class, in any numbering.
    distance : (N,) float64, metres, NaN where unknown
    share : (N,) float64, percent
        What a threshold compares: `Evidence.match_percent` where tags decide, or the
        share of pixels that are the object's own, where a channel does.
    by_tags : (N,) bool
        `threshold_small_box` decided, and no other rule.
    by_own : (N,) bool
        `min_visible_percent` decided, and no other rule.
    kept : (N,) bool
    visible : (N,) bool
        Whether the object is visible: the truth.
    """

    class_key: IntArray
    distance: FloatArray
    share: FloatArray
    by_tags: BoolArray
    by_own: BoolArray
    kept: BoolArray
    visible: BoolArray

    @classmethod
    def of(cls, evidence: Evidence, config: FilterConfig, visible: BoolArray) -> Judged:
        """Decide N boxes, of truth `visible` (N,); unmeasured ones are left out."""
        decisions = decide(evidence, config)
        is_measured = VERDICT_OF_REASON[decisions.reason] != UNMEASURED
        by_channel = decisions.channel > 0
        own = own_percent(evidence, config.channels)
        passes = decide(evidence, _without_share(config)).reason == Reason.VISIBLE
        return cls(
            class_key=evidence.class_index.astype(np.int64),
            distance=evidence.distance,
            share=np.where(by_channel, own, evidence.match_percent),
            by_tags=~by_channel
            & ~decisions.large
            & np.isin(decisions.reason, _BY_THRESHOLD),
            by_own=by_channel & passes & ~np.isnan(own),
            kept=decisions.reason == Reason.VISIBLE,
            visible=visible,
        ).where(is_measured)

    @classmethod
    def joined(cls, parts: Iterable[Judged]) -> Judged:
        """The boxes of one or more parts, in the order of the parts."""
        listed = list(parts)
        return cls(
            *(
                np.concatenate([getattr(part, spec.name) for part in listed])
                for spec in fields(cls)
            )
        )

    @property
    def confusion(self) -> Confusion:
        """All boxes together."""
        return Confusion.of(self.kept, self.visible)

    def where(self, rows: BoolArray) -> Judged:
        """The boxes for which `rows` (N,) is True."""
        return rows_of(self, rows)

    def __len__(self) -> int:
        return len(self.kept)


def _without_share(config: FilterConfig) -> FilterConfig:
    """The configuration without `min_visible_percent`."""
    classes = {
        name: replace(override, min_visible_percent=INHERIT)
        for name, override in config.classes.items()
    }
    return replace(config, min_visible_percent=0, classes=classes)


def suggest_per_class(
    judged: Judged, classes: Mapping[str, int], config: FilterConfig, goal: Goal
) -> list[Suggestion]:
    """A threshold for each class that has boxes of both kinds.

    Two of a class if tags decide some of its boxes, and a channel others. `judged` is
    under `config`; `classes` gives the number of each class in `judged.class_key`.
    """
    suggestions = []
    for name, number in classes.items():
        mine = judged.where(judged.class_key == number)
        limits = config.limits_of(name)
        for key, is_free in (
            ("threshold_small_box", mine.by_tags),
            ("min_visible_percent", mine.by_own),
        ):
            free = mine.where(is_free)
            strict = config.profile == "carlasimu" and key == "threshold_small_box"
            others = mine.where(~is_free).confusion
            answers = Answers(free.share, free.visible, others, strict, name, key)
            suggestion = suggest(answers, float(getattr(limits, key)), goal)
            if suggestion is not None:
                suggestions.append(suggestion)
    return suggestions


def with_thresholds(
    config: FilterConfig, suggestions: Iterable[Suggestion]
) -> FilterConfig:
    """The configuration with the suggested threshold of each class."""
    change: Callable[..., ClassConfig] = replace
    for suggestion in suggestions:
        name = canonical_class(suggestion.class_name)
        changed = change(
            config.of_class(name), **{suggestion.key: suggestion.threshold}
        )
        config = replace(config, classes={**config.classes, name: changed})
    return config


class TruthCollector:
    """Collects boxes of known truth, frame by frame, decided by ``semantic``.

    It keeps about 40 bytes per box.
    """

    def __init__(self, config: FilterConfig) -> None:
        self.config = replace(config, evidence="semantic")
        self._classes: dict[str, int] = {}
        self._parts: list[Judged] = []

    def add(self, evidence: Evidence, visible: BoolArray) -> None:
        """Add the boxes of a frame; `visible` (N,) is the truth."""
        keys = [
            self._classes.setdefault(name, len(self._classes))
            for name in evidence.class_names
        ]
        judged = Judged.of(evidence, self.config, visible)
        numbered = np.array(keys, np.int64)[judged.class_key]
        self._parts.append(replace(judged, class_key=numbered))

    def suggestions(self, goal: Goal) -> list[Suggestion]:
        """A threshold for each class that has boxes of both kinds, by name."""
        if not self._parts:
            return []
        judged = Judged.joined(self._parts)
        names = dict(sorted(self._classes.items()))
        return suggest_per_class(judged, names, self.config, goal)
