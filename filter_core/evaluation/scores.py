"""Counts of right and wrong verdicts, and scores with their 95 % intervals."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from operator import add
from typing import Final, TypedDict

import numpy as np

from filter_core.arrays import BoolArray, FloatArray, IntArray
from filter_core.decisions.rules import Z95

BANDS: Final = ("0-50", "50-100", "100-150", "150-200", ">200", "unknown")
"""Bands of distance in metres; each includes its lower end."""

_EDGES: Final = np.array([50.0, 100.0, 150.0, 200.0])


class MeasuredObject(TypedDict):
    """A `Measured` as JSON."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Measured:
    """A number with its 95 % interval: a share, 0..1, or a kappa, -1..1."""

    value: float
    low: float
    high: float

    def as_dict(self) -> MeasuredObject:
        """Ready for JSON."""
        return {"value": self.value, "low": self.low, "high": self.high}


class ConfusionObject(TypedDict):
    """A `Confusion` and its scores as JSON."""

    kept_visible: int
    kept_hidden: int
    rejected_visible: int
    rejected_hidden: int
    precision: MeasuredObject | None
    recall: MeasuredObject | None
    f1: MeasuredObject | None


@dataclass(frozen=True)
class Confusion:
    """Verdicts compared with the truth; ``kept`` is the positive class.

    ``kept_hidden`` are ghosts that were kept, ``rejected_visible`` visible objects that
    were lost.
    """

    kept_visible: int = 0
    kept_hidden: int = 0
    rejected_visible: int = 0
    rejected_hidden: int = 0

    @classmethod
    def of(cls, kept: BoolArray, visible: BoolArray) -> Confusion:
        """Count N boxes, of which `kept` and `visible` (N,) say what they are."""
        return cls(
            int(np.count_nonzero(kept & visible)),
            int(np.count_nonzero(kept & ~visible)),
            int(np.count_nonzero(~kept & visible)),
            int(np.count_nonzero(~kept & ~visible)),
        )

    def __add__(self, other: Confusion) -> Confusion:
        return Confusion(*map(add, astuple(self), astuple(other)))

    @property
    def boxes(self) -> int:
        """How many were counted."""
        return sum(astuple(self))

    @property
    def precision(self) -> Measured | None:
        """Of the kept boxes, those that are visible; None if none was kept."""
        return share(self.kept_visible, self.kept_visible + self.kept_hidden)

    @property
    def recall(self) -> Measured | None:
        """Of the visible boxes, those that were kept; None if none is visible."""
        return share(self.kept_visible, self.kept_visible + self.rejected_visible)

    @property
    def f1(self) -> Measured | None:
        """The harmonic mean of both; None if nothing is visible and nothing was kept.

        Notes
        -----
        ``F1 = 2 J / (1 + J)``, where J is the share of rightly kept boxes among all
        that are kept or visible. J is a binomial share, so it has a Wilson interval. F1
        increases with J, so the ends of its interval are those of J's, transformed.
        """
        wrong = self.kept_hidden + self.rejected_visible
        jaccard = share(self.kept_visible, self.kept_visible + wrong)
        if jaccard is None:
            return None
        low, high = _f1_of(jaccard.low), _f1_of(jaccard.high)
        return Measured(_f1_of(jaccard.value), low, high)

    def as_dict(self) -> ConfusionObject:
        """Counts and scores, ready for JSON."""
        return {
            "kept_visible": self.kept_visible,
            "kept_hidden": self.kept_hidden,
            "rejected_visible": self.rejected_visible,
            "rejected_hidden": self.rejected_hidden,
            "precision": _object_or_none(self.precision),
            "recall": _object_or_none(self.recall),
            "f1": _object_or_none(self.f1),
        }


def _object_or_none(score: Measured | None) -> MeasuredObject | None:
    return None if score is None else score.as_dict()


def share(part: int, whole: int) -> Measured | None:
    """``part / whole`` with its Wilson interval; None if `whole` is 0."""
    if whole == 0:
        return None
    low, high = wilson_interval(part, whole)
    return Measured(part / whole, low, high)


def wilson_interval(part: int, whole: int) -> tuple[float, float]:
    """The 95 % Wilson interval of ``part / whole``; always within 0..1.

    `whole` is 1 at least.

    References
    ----------
    .. [1] E. B. Wilson, "Probable inference, the law of succession, and statistical
       inference", JASA 22, 1927.
    """
    p, spread = part / whole, Z95 * Z95 / whole
    centre = (p + spread / 2) / (1 + spread)
    half = math.sqrt(p * (1 - p) * spread + spread * spread / 4) / (1 + spread)
    # Exactly 0 and 1 at the ends, which rounding could miss.
    low = 0.0 if part == 0 else centre - half
    high = 1.0 if part == whole else centre + half
    return low, high


def band_index(distance: FloatArray) -> IntArray:
    """(N,) int64: which of `BANDS` each distance lies in; NaN is unknown."""
    index = np.searchsorted(_EDGES, distance, side="right").astype(np.int64)
    index[np.isnan(distance)] = len(BANDS) - 1
    return index


def _f1_of(jaccard: float) -> float:
    return 2 * jaccard / (1 + jaccard)
