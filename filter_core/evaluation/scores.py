"""Counts of right and wrong verdicts, and scores with their intervals. No pixels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from filter_core.decisions.rules import Z95
from filter_core.types import BoolArray, FloatArray, IntArray

BANDS: Final = ("0-50", "50-100", "100-150", "150-200", ">200", "unknown")
"""Distances in metres; a band begins with its lower end."""

_EDGES: Final = np.array([50.0, 100.0, 150.0, 200.0])


@dataclass(frozen=True)
class Measured:
    """A share with its 95 % interval, all 0..1."""

    value: float
    low: float
    high: float

    def as_dict(self) -> dict[str, float]:
        """As answers give it."""
        return {"value": self.value, "low": self.low, "high": self.high}


@dataclass(frozen=True)
class Confusion:
    """The filter's verdicts against what is true; ``kept`` is the positive class.

    Attributes
    ----------
    kept_visible : int
        Rightly kept.
    kept_hidden : int
        Ghosts that were kept.
    rejected_visible : int
        Visible objects that were lost.
    rejected_hidden : int
        Rightly rejected.
    """

    kept_visible: int = 0
    kept_hidden: int = 0
    rejected_visible: int = 0
    rejected_hidden: int = 0

    @classmethod
    def of(cls, kept: BoolArray, visible: BoolArray) -> Confusion:
        """Count N boxes."""
        return cls(
            int(np.count_nonzero(kept & visible)),
            int(np.count_nonzero(kept & ~visible)),
            int(np.count_nonzero(~kept & visible)),
            int(np.count_nonzero(~kept & ~visible)),
        )

    def __add__(self, other: Confusion) -> Confusion:
        return Confusion(
            self.kept_visible + other.kept_visible,
            self.kept_hidden + other.kept_hidden,
            self.rejected_visible + other.rejected_visible,
            self.rejected_hidden + other.rejected_hidden,
        )

    @property
    def boxes(self) -> int:
        """How many were counted."""
        return (
            self.kept_visible
            + self.kept_hidden
            + self.rejected_visible
            + self.rejected_hidden
        )

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
        ``F1 = 2 J / (1 + J)`` with J the share of rightly kept among all boxes that are
        kept or visible. J is a share of a number of boxes, so it has a Wilson interval,
        and what rises with J has that interval carried over.
        """
        wrong = self.kept_hidden + self.rejected_visible
        found = share(self.kept_visible, self.kept_visible + wrong)
        if found is None:
            return None
        low, high = _f1_of(found.low), _f1_of(found.high)
        return Measured(_f1_of(found.value), low, high)

    def as_dict(self) -> dict[str, Any]:
        """Counts and scores, ready for JSON."""
        scores = {"precision": self.precision, "recall": self.recall, "f1": self.f1}
        return {
            "kept_visible": self.kept_visible,
            "kept_hidden": self.kept_hidden,
            "rejected_visible": self.rejected_visible,
            "rejected_hidden": self.rejected_hidden,
        } | {
            name: None if one is None else one.as_dict() for name, one in scores.items()
        }


def share(part: int, whole: int) -> Measured | None:
    """A share of a count with its Wilson interval; None of nothing."""
    if whole == 0:
        return None
    low, high = wilson_interval(part, whole)
    return Measured(part / whole, low, high)


def wilson_interval(part: int, whole: int) -> tuple[float, float]:
    """The 95 % interval of a share, 0..1; it stays inside, however few were counted.

    References
    ----------
    .. [1] E. B. Wilson, "Probable inference, the law of succession, and statistical
       inference", JASA 22, 1927.
    """
    p, spread = part / whole, Z95 * Z95 / whole
    center = (p + spread / 2) / (1 + spread)
    half = math.sqrt(p * (1 - p) * spread + spread * spread / 4) / (1 + spread)
    # At either end the bound is the share itself, which rounding may miss by a hair.
    low = 0.0 if part == 0 else center - half
    high = 1.0 if part == whole else center + half
    return low, high


def band_index(distance: FloatArray) -> IntArray:
    """(N,) int64: which of `BANDS` each distance lies in; NaN is unknown."""
    index = np.searchsorted(_EDGES, distance, side="right").astype(np.int64)
    index[np.isnan(distance)] = len(BANDS) - 1
    return index


def _f1_of(jaccard: float) -> float:
    return 2 * jaccard / (1 + jaccard)
