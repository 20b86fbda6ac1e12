"""Estimates how good the filter is on all boxes, from people's answers on some.

Which boxes have an answer may depend on anything: doubtful ones are asked first, and
somebody who looks at many boxes answers those that look wrong. Such answers represent
no other box. What represents all is a part of the boxes that chance has chosen: those
up to a place of the random order, in which every box has a permanent place. All of them
count, whoever has answered them and why.

`count_answers` sorts boxes into the cells of a table, `estimate` computes the scores
and their intervals from it, and `plan` how many boxes more certain ones need.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from filter_core.arrays import BoolArray, FloatArray, IntArray
from filter_core.evaluation.scores import Measured

WIDEST: Final = 0.1
"""An interval that extends farther to either side says too little: it is refused."""

NARROW: Final = 0.05
"""With intervals of this half-width, no more answers are asked for."""

_DRAWS: Final = 2000
_SEED: Final = 0
"""Of the draws: the same answers always give the same interval."""

_LEVELS: Final = (0.025, 0.975)
_LIKELY: Final = np.array([0.2, 0.8])
"""The share of visible boxes among rejected and kept ones, as long as little is known:
for plans only. It counts as much as `_LIKELY_ANSWERS` answers."""
_LIKELY_ANSWERS: Final = 5
_PLANS: Final = (100, 200, 300, 400, 500, 700, 1000, 1500, 2000, 3000, 5000, 10_000)
"""Numbers of boxes that plans are chosen from."""


class Part(IntEnum):
    """How boxes relate to the random sample.

    BEFORE: decided by people before the sample was begun; the sample is of the others.
    SAMPLE: up to the place of the random order that people have come to. REST: beyond.
    """

    BEFORE = 0
    SAMPLE = 1
    REST = 2


class Said(IntEnum):
    """What people have said of a box."""

    NOTHING = 0
    REJECT = 1
    KEEP = 2
    UNSURE = 3


def count_answers(
    group: IntArray, kept: BoolArray, part: IntArray, said: IntArray, groups: int
) -> IntArray:
    """(groups, 2, 3, 4) int64: N boxes counted by group, verdict, part and answer.

    All columns are (N,): numbers of `group` from 0, the filter's verdict (`kept`),
    `Part` and `Said`.
    """
    cell = ((group * 2 + kept) * len(Part) + part) * len(Said) + said
    counts = np.bincount(cell, minlength=groups * 2 * len(Part) * len(Said))
    table: IntArray = counts.reshape(groups, 2, len(Part), len(Said))
    return table


@dataclass(frozen=True)
class Estimate:
    """Scores of the filter on all boxes, 0..1; None where there is no box to score."""

    precision: Measured | None
    recall: Measured | None
    f1: Measured | None

    @property
    def half_width(self) -> float:
        """That of the widest interval, 0..1."""
        scores = (self.precision, self.recall, self.f1)
        return max((half_width(score) for score in scores if score), default=0.0)


def half_width(score: Measured) -> float:
    """How far an interval extends from its middle."""
    return (score.high - score.low) / 2


def estimate(table: IntArray) -> Estimate:
    """Precision, recall and F1 on all boxes, with 95 % intervals.

    Parameters
    ----------
    table : (G, 2, 3, 4) int64
        As `count_answers` returns it. Each group is a stratum with a sample of its own:
        boxes of which people have come to the same place of the random order. A stratum
        without a sample is allowed; then its boxes can be anything.

    Notes
    -----
    The numbers of kept and rejected boxes are known. Unknown is how many of each are
    visible, so every group is stratified by verdict after the draw. Within such a
    stratum the sample is a simple random one, of the boxes that were not decided before
    it [1]_; every answer in it has the same inclusion probability and stands for
    ``N / n`` boxes, as in the estimator of Horvitz and Thompson [2]_. Answers from
    before stand for themselves.

    The number of visible boxes of a stratum has exact limits (those of Clopper and
    Pearson, for a finite population): given ``x`` visible boxes in a sample of ``n`` of
    ``N``, its lower limits are the quantiles of ``x + BetaBinomial(N - n, x, n-x+1)``,
    its upper ones those of ``x + BetaBinomial(N - n, x+1, n-x)``. The scores increase
    with the visible boxes among kept ones, and decrease with those among rejected ones.
    So their lower limits are quantiles of the score of draws from the lower limits of
    the one and the upper limits of the other, and the reverse: *melding* [3]_, which is
    conservative also for small numbers, and for shares of 0 or 1.

    Boxes of the sample without an answer count as hidden in lower limits and as visible
    in upper ones. Those that people were unsure about are taken to be like the others.
    Known answers outside of the sample only exclude what they contradict.

    References
    ----------
    .. [1] W. G. Cochran, "Sampling Techniques", 3rd edition, 1977, chapters 3 and 5A.
    .. [2] D. G. Horvitz, D. J. Thompson, "A generalization of sampling without
       replacement from a finite universe", JASA 47, 1952.
    .. [3] M. P. Fay, M. A. Proschan, E. Brittain, "Combining one-sided confidence
       procedures for inference in the two-sample case", Biometrics 71, 2015.
    """
    generator = np.random.default_rng(_SEED)
    lost, hits = (_visible(table[:, verdict], generator) for verdict in (0, 1))
    kept = float(table[:, 1].sum())
    opposite = lost[::-1]  # a score is lowest where most boxes are lost
    return Estimate(
        _measured([a / kept for a in hits]) if kept else None,
        _measured([_ratio(a, a + b) for a, b in zip(hits, opposite, strict=True)]),
        _measured(
            [_ratio(2 * a, kept + a + b) for a, b in zip(hits, opposite, strict=True)]
        ),
    )


def _visible(
    strata: IntArray, generator: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Visible boxes among those of one verdict: lower limits, estimate, upper limits.

    Each has `_DRAWS` values, of which those of the estimate are all the same.
    """
    lows, values, highs = np.zeros((3, _DRAWS))
    for counts in strata:
        boxes = int(counts[Part.SAMPLE :].sum())
        keep, reject = counts[Part.SAMPLE, [Said.KEEP, Said.REJECT]].tolist()
        silent = int(counts[Part.SAMPLE, Said.NOTHING])
        sample = keep + reject + silent
        least = keep + int(counts[Part.REST, Said.KEEP])
        most = boxes - reject - int(counts[Part.REST, Said.REJECT])
        answered = keep + reject
        value = boxes * keep / answered if answered else (least + most) / 2
        low = keep + _beta_binomial(generator, boxes - sample, keep, sample - keep + 1)
        high = (
            keep
            + silent
            + _beta_binomial(generator, boxes - sample, keep + silent + 1, reject)
        )
        before = counts[Part.BEFORE, Said.KEEP]
        lows += before + np.clip(low, least, most)
        values += before + np.clip(value, least, most)
        highs += before + np.clip(high, least, most)
    return lows, values, highs


def _beta_binomial(
    generator: np.random.Generator, trials: int, a: int, b: int
) -> IntArray:
    """`_DRAWS` numbers; `a` or `b` may be 0."""
    successes = generator.standard_gamma(a, _DRAWS)
    failures = generator.standard_gamma(b, _DRAWS)
    draws: IntArray = generator.binomial(trials, successes / (successes + failures))
    return draws


def _ratio(part: FloatArray, whole: FloatArray) -> FloatArray:
    """(R,): `part / whole`, and NaN where `whole` is 0."""
    ratio = np.full(len(part), np.nan)
    np.divide(part, whole, out=ratio, where=whole > 0)
    return ratio


def _measured(scores: list[FloatArray]) -> Measured | None:
    """A score from its lower limits, its estimate and its upper limits.

    Where a draw has no visible box, the score is not defined, and may be anything.
    """
    lows, (value, *_), highs = scores
    if np.isnan(value):
        return None
    low = float(np.quantile(np.nan_to_num(lows, nan=0.0), _LEVELS[0]))
    high = float(np.quantile(np.nan_to_num(highs, nan=1.0), _LEVELS[1]))
    return Measured(float(value), min(low, float(value)), max(high, float(value)))


def plan(table: IntArray, half_width: float) -> tuple[int, float]:
    """How many boxes a random sample of all needs for intervals that are narrow enough.

    The first of some round numbers that is likely to suffice, and the half-width that
    it is likely to give. If none suffices, all boxes. `table` is as for `estimate`;
    `half_width`, 0..1, is what the intervals of all scores should have at most.
    """
    merged = table.sum(axis=0)
    drawn = merged[:, Part.SAMPLE :].sum(axis=1)
    boxes, strata = drawn.sum(axis=1), merged[:, Part.SAMPLE]
    total = int(boxes.sum())
    answered = strata[:, [Said.KEEP, Said.REJECT]].sum(axis=1)
    likely = (strata[:, Said.KEEP] + _LIKELY_ANSWERS * _LIKELY) / (
        answered + _LIKELY_ANSWERS
    )
    for size in (plan_size for plan_size in _PLANS if plan_size < total):
        sample = np.rint(size * boxes / total).astype(np.int64)
        keep = np.rint(sample * likely).astype(np.int64)
        expected = np.zeros((1, *merged.shape), np.int64)
        expected[0, :, Part.BEFORE] = merged[:, Part.BEFORE]
        expected[0, :, Part.SAMPLE, Said.KEEP] = keep
        expected[0, :, Part.SAMPLE, Said.REJECT] = sample - keep
        expected[0, :, Part.REST, Said.NOTHING] = boxes - sample
        width = estimate(expected).half_width
        if width <= half_width:
            return size, width
    return total, 0.0
