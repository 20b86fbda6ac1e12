"""Agreement between people, and agreement beyond chance (kappa)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from filter_core.arrays import BoolArray, FloatArray, IntArray
from filter_core.decisions.rules import Z95
from filter_core.evaluation.scores import Measured


@dataclass(frozen=True)
class Pair:
    """Two people, by their numbers, ``a < b``, and the boxes that both answered.

    `table`, (2, 2) int64, counts them by the answer of `a`, then of `b`; 0 is reject, 1
    is keep.
    """

    a: int
    b: int
    table: IntArray

    @property
    def boxes(self) -> int:
        """How many both answered."""
        return int(self.table.sum())

    @property
    def agreed(self) -> int:
        """How many of those both answered alike."""
        return int(np.trace(self.table))

    @property
    def kappa(self) -> Measured | None:
        """Their agreement beyond chance, -1..1; None if undefined."""
        return cohen_kappa(self.table)


@dataclass(frozen=True)
class Agreement:
    """The agreement of several people on the same boxes.

    `boxes` have answers of two or more people; those of `agreed` are all the same.
    `pairs` are every two people who answered a common box, sorted by `a` and `b`.
    """

    boxes: int
    agreed: int
    pairs: list[Pair]

    @property
    def kappa(self) -> Measured | None:
        """Cohen's kappa of the sum of all pairs' tables, -1..1; None if undefined."""
        tables = [pair.table for pair in self.pairs]
        return cohen_kappa(np.sum(tables, axis=0)) if tables else None


def agreement(box: IntArray, person: IntArray, keep: BoolArray) -> Agreement:
    """Compare the answers of people who answered the same boxes.

    Parameters
    ----------
    box : (N,) int64
        The box of each answer.
    person : (N,) int64
        Who gave it; a box and a person occur together once at most.
    keep : (N,) bool
        Whether the answer is keep.

    Notes
    -----
    Answers are sorted by box; answers to the same box that are `step` rows apart are
    pairs. Steps go from 1 to the largest number of people per box, less one.
    O(N log N) for a bounded number of people per box.
    """
    order = np.lexsort((person, box))
    box, person, keep = box[order], person[order], keep[order]
    counted: dict[tuple[int, int], IntArray] = {}
    step = 1
    while True:
        rows = np.flatnonzero(box[step:] == box[:-step])
        if not len(rows):
            break
        second = rows + step
        people, index = np.unique(
            np.column_stack([person[rows], person[second]]), axis=0, return_inverse=True
        )
        cell = index.reshape(-1) * 4 + keep[rows] * 2 + keep[second]
        tables = np.bincount(cell, minlength=4 * len(people)).reshape(-1, 2, 2)
        for (a, b), table in zip(people.tolist(), tables, strict=True):
            counted[a, b] = counted.get((a, b), 0) + table
        step += 1
    _, first, answers = np.unique(box, return_index=True, return_counts=True)
    keeps = np.add.reduceat(keep.astype(np.int64), first) if len(box) else answers
    several = answers > 1
    unanimous = several & ((keeps == 0) | (keeps == answers))
    pairs = [Pair(*people, table) for people, table in sorted(counted.items())]
    return Agreement(int(several.sum()), int(unanimous.sum()), pairs)


def cohen_kappa(table: IntArray) -> Measured | None:
    """Agreement of two people beyond what chance would give, -1..1.

    It has a 95 % interval. None if undefined: no boxes, or both always gave the same
    one answer. `table`, (K, K) int64, counts boxes by the answer of the one, then of
    the other.

    References
    ----------
    .. [1] J. Cohen, "A coefficient of agreement for nominal scales", Educational and
       Psychological Measurement 20, 1960.
    .. [2] J. L. Fleiss, J. Cohen, B. S. Everitt, "Large sample standard errors of kappa
       and weighted kappa", Psychological Bulletin 72, 1969, equation 13.
    """
    total = int(table.sum())
    if total == 0:
        return None
    share: FloatArray = table / total
    row, column = share.sum(axis=1), share.sum(axis=0)
    observed, by_chance = float(np.trace(share)), float(row @ column)
    if by_chance == 1.0:
        return None
    value = (observed - by_chance) / (1.0 - by_chance)
    agree = np.diagonal(share)
    same = (agree * (1 - by_chance - (row + column) * (1 - observed)) ** 2).sum()
    # p_ij (p_.i + p_j.)^2 wherever i is not j.
    weights = share * (column[:, None] + row[None, :]) ** 2
    other = (1 - observed) ** 2 * (weights.sum() - np.trace(weights))
    mean = observed * by_chance - 2 * by_chance + observed
    variance = (same + other - mean**2) / (total * (1 - by_chance) ** 4)
    half = Z95 * math.sqrt(max(0.0, float(variance)))
    return Measured(value, max(-1.0, value - half), min(1.0, value + half))
