"""A suggested threshold for every class, from boxes whose truth is known."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from filter_core.classes import canonical_class
from filter_core.config.filter import FilterConfig
from filter_core.decisions.rules import decide
from filter_core.evaluation.scores import Confusion
from filter_core.evaluation.thresholds import Answers, Goal, Suggestion, suggest
from filter_core.types import BoolArray, Evidence, FloatArray, IntArray, Reason

_BY_THRESHOLD: Final = (Reason.VISIBLE, Reason.BELOW_THRESHOLD)


@dataclass(frozen=True, eq=False)
class Judged:
    """What the filter says of N boxes, and what is true of them.

    Attributes
    ----------
    class_key : (N,) int64
        The number of each box's class, whoever numbers them.
    distance : (N,) float64, metres, NaN where unknown
    match : (N,) float64, percent
    by_threshold : (N,) bool
        The threshold for small boxes decided, and no other rule.
    kept : (N,) bool
    visible : (N,) bool
        The truth.
    """

    class_key: IntArray
    distance: FloatArray
    match: FloatArray
    by_threshold: BoolArray
    kept: BoolArray
    visible: BoolArray

    @classmethod
    def of(cls, evidence: Evidence, config: FilterConfig, visible: BoolArray) -> Judged:
        """Decide N boxes; without those that nothing could be measured of."""
        decisions = decide(evidence, config)
        known = decisions.reason != Reason.NO_SEGMENTATION
        return cls(
            evidence.class_index.astype(np.int64),
            evidence.distance,
            evidence.match_percent,
            is_by_threshold(decisions.reason, decisions.large),
            decisions.reason == Reason.VISIBLE,
            visible,
        ).where(known)

    @classmethod
    def joined(cls, parts: Iterable[Judged]) -> Judged:
        """One after the other; at least one."""
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
        """Some of the boxes."""
        return Judged(*(getattr(self, spec.name)[rows] for spec in fields(self)))

    def __len__(self) -> int:
        return len(self.kept)


def is_by_threshold(reason: NDArray[np.integer[Any]], large: BoolArray) -> BoolArray:
    """(N,) bool: whether the threshold for small boxes decided."""
    decided: BoolArray = np.isin(reason, _BY_THRESHOLD) & ~large
    return decided


@dataclass(frozen=True)
class ClassSuggestion:
    """What the boxes of one class speak for; `boxes` have a known truth."""

    class_name: str
    current: float
    boxes: int
    found: Suggestion

    def as_dict(self) -> dict[str, Any]:
        """As answers give it."""
        return {
            "class": self.class_name,
            "current": self.current,
            "suggested": self.found.threshold,
            "interval": list(self.found.interval),
            "answers": self.boxes,
            "f1_current": self.found.at_current.f1,
            "f1_suggested": self.found.at_suggested.f1,
            "curve": [asdict(point) for point in self.found.curve],
        }


def suggest_per_class(
    judged: Judged, classes: Mapping[str, int], config: FilterConfig, goal: Goal
) -> list[ClassSuggestion]:
    """A threshold for each class that has boxes of both kinds.

    Parameters
    ----------
    judged : Judged under `config`
    classes : name -> number that `judged.class_key` uses
    config : FilterConfig
    goal : Goal

    Returns
    -------
    list of ClassSuggestion
        None of a configuration whose evidence is not ``semantic``: no threshold
        decides then.
    """
    if config.evidence != "semantic":
        return []
    limits = config.thresholds_for(list(classes)).threshold_small_box.tolist()
    suggestions = []
    for (name, key), current in zip(classes.items(), limits, strict=True):
        mine = judged.where(judged.class_key == key)
        free, others = mine.where(mine.by_threshold), mine.where(~mine.by_threshold)
        answers = Answers(
            free.match,
            free.visible,
            others.confusion,
            strict=config.profile == "carlasimu",
        )
        found = suggest(answers, current, goal)
        if found is not None:
            suggestions.append(ClassSuggestion(name, current, len(answers), found))
    return suggestions


def with_thresholds(
    config: FilterConfig, suggestions: Iterable[ClassSuggestion]
) -> FilterConfig:
    """The configuration with the suggested threshold of each class."""
    classes = dict(config.classes)
    for one in suggestions:
        key = canonical_class(one.class_name)
        classes[key] = replace(
            config.of_class(key), threshold_small_box=one.found.threshold
        )
    return replace(config, classes=classes)


@dataclass
class TruthCollector:
    """Boxes of known truth, gathered frame by frame under ``evidence: semantic``.

    About 40 bytes are kept of each box.
    """

    config: FilterConfig
    _classes: dict[str, int] = field(default_factory=dict)
    _parts: list[Judged] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.config = replace(self.config, evidence="semantic")

    def add(self, evidence: Evidence, visible: BoolArray) -> None:
        """Boxes of a frame; `visible` (N,) is the truth."""
        keys = [
            self._classes.setdefault(name, len(self._classes))
            for name in evidence.class_names
        ]
        judged = Judged.of(evidence, self.config, visible)
        numbered = np.array(keys, np.int64)[judged.class_key]
        self._parts.append(replace(judged, class_key=numbered))

    def suggestions(self, goal: Goal) -> list[ClassSuggestion]:
        """A threshold for each class that has boxes of both kinds, by name."""
        if not self._parts:
            return []
        judged = Judged.joined(self._parts)
        names = dict(sorted(self._classes.items()))
        return suggest_per_class(judged, names, self.config, goal)
