"""Estimates from a random sample: hundreds of simulated reviewers of each order.

Every reviewer answers without an error, so that the truth is what the answers on all
boxes would give.
"""

from functools import partial

import numpy as np
import pytest

from filter_core.evaluation.sampling import (
    WIDEST,
    Part,
    Said,
    count_answers,
    estimate,
    half_width,
    plan,
)
from filter_core.evaluation.scores import Confusion, Measured

REVIEWERS = 400
# A quarter of the demo's street, decided by tags: of six kinds of boxes, how many there
# are. Recall is 82 %, F1 78 %.
KINDS = {
    # class, kept, visible
    (0, True, True): 400,
    (1, True, True): 196,
    (0, True, False): 150,
    (1, True, False): 54,
    (0, False, True): 90,
    (1, False, True): 41,
    (0, False, False): 500,
    (1, False, False): 150,
}
CLASS, KEPT, VISIBLE = (
    np.repeat([kind[at] for kind in KINDS], list(KINDS.values())) for at in range(3)
)
BOXES = len(KEPT)
# The first boxes in the order of doubt are wrong far more often than the others.
DOUBTFUL = np.argsort(
    np.random.default_rng(7).normal(size=BOXES) - 1.2 * (KEPT != VISIBLE) - 0.5 * ~KEPT
)
SCORES = ("precision", "recall", "f1")


def scores_of(rows):
    scores = Confusion.of(KEPT[rows], VISIBLE[rows])
    return {name: getattr(scores, name).value for name in SCORES}


class Reviewer:
    """Answers boxes in several orders; `place` is the random order of the boxes."""

    def __init__(self, chance):
        self.chance, self.place = chance, chance.random(BOXES)
        self.is_known, self.is_before = np.zeros((2, BOXES), np.bool_)
        self.reach = np.zeros(2)

    def doubt(self, count):
        free = DOUBTFUL[~self.is_known[DOUBTFUL]]
        self.is_known[free[:count]] = True

    def random(self, count, *, classes=(0, 1)):
        if not self.reach.any():
            self.is_before = self.is_known.copy()
        in_order = np.argsort(self.place)
        of_classes = np.isin(CLASS[in_order], classes)
        free = in_order[of_classes & ~self.is_known[in_order]][:count]
        self.is_known[free] = True
        self.reach[list(classes)] = self.place[free[-1]]

    def reject_ghosts(self, count):
        """Look at some boxes in a grid, and reject those that are not visible."""
        seen = self.chance.choice(BOXES, count, replace=False)
        self.is_known[seen[~VISIBLE[seen]]] = True

    def table(self):
        """(2, 2, 3, 4): one group for each class."""
        is_drawn = self.place <= self.reach[CLASS]
        part = np.where(is_drawn, Part.SAMPLE, Part.REST)
        part[self.is_before] = Part.BEFORE
        said = np.where(VISIBLE, Said.KEEP, Said.REJECT) * self.is_known
        return count_answers(CLASS, KEPT, part, said, groups=2)


DOUBT, RANDOM, GHOSTS = Reviewer.doubt, Reviewer.random, Reviewer.reject_ghosts
# All in turn, as two people do at the same time, and a third one in the grid.
MIXED = [(DOUBT, 64), *[(RANDOM, 40), (DOUBT, 64), (GHOSTS, 150)] * 3]
OF_A_CLASS = partial(RANDOM, classes=(1,))


@pytest.mark.parametrize(
    ("steps", "classes", "widest"),
    [
        pytest.param([(RANDOM, 150)], [0, 1], 0.11, marks=pytest.mark.long),
        pytest.param([(DOUBT, 100)], [0, 1], 0.5, marks=pytest.mark.long),
        pytest.param(
            [(DOUBT, 400), (RANDOM, 150)], [0, 1], 0.1, marks=pytest.mark.long
        ),
        pytest.param([(OF_A_CLASS, 100)], [1], 0.13, marks=pytest.mark.long),
        (MIXED, [0, 1], 0.12),
        pytest.param([(RANDOM, 12)], [0, 1], 0.4, marks=pytest.mark.long),
    ],
)
def test_intervals_cover_the_scores_on_all_boxes(steps, classes, widest):
    truth = scores_of(np.isin(CLASS, classes))
    chance = np.random.default_rng(3)
    intervals = np.empty((REVIEWERS, len(SCORES), 2))
    for number in range(REVIEWERS):
        reviewer = Reviewer(chance)
        for answer, count in steps:
            answer(reviewer, count)
        table = reviewer.table()[classes].sum(axis=0, keepdims=True)
        estimated = estimate(table)
        for at, name in enumerate(SCORES):
            score = getattr(estimated, name)
            intervals[number, at] = (score.low, score.high) if score else (0, 1)

    expected = np.array([truth[name] for name in SCORES])
    covers = (intervals[..., 0] <= expected) & (expected <= intervals[..., 1])
    # Three standard errors of 95 % in so many reviewers.
    assert (covers.mean(axis=0) >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / REVIEWERS)).all()
    assert (np.diff(intervals)[..., 0].mean(axis=0) / 2 <= widest).all()


def test_perfect_reviewer_of_the_doubtful_boxes_cannot_say_how_good_the_filter_is():
    reviewer = Reviewer(np.random.default_rng(1))
    reviewer.doubt(100)
    answered = scores_of(reviewer.is_known)

    estimated = estimate(reviewer.table())

    # The answered boxes alone would give figures that are far from those of all.
    assert answered["recall"] < scores_of(slice(None))["recall"] - 0.25
    for name in SCORES:
        assert half_width(getattr(estimated, name)) > WIDEST


def test_unanswered_boxes_of_the_sample_widen_the_intervals():
    table = np.zeros((1, 2, 3, 4), np.int64)
    table[0, :, Part.SAMPLE, Said.KEEP] = [10, 80]
    table[0, :, Part.SAMPLE, Said.REJECT] = [90, 20]
    table[0, :, Part.REST, Said.NOTHING] = 400
    gaps = table.copy()
    gaps[0, 1, Part.SAMPLE, Said.NOTHING] = 20
    gaps[0, 1, Part.REST, Said.NOTHING] -= 20

    full, partial = estimate(table).precision, estimate(gaps).precision

    assert full
    assert partial
    # With all of them hidden, or all of them visible.
    assert partial.low < full.low - 0.08
    assert partial.high > full.high + 0.02
    assert partial.value == full.value == 0.8


def test_scores_are_exact_if_all_boxes_are_answered_and_undefined_without_any():
    table = np.zeros((1, 2, 3, 4), np.int64)
    table[0, :, Part.BEFORE, Said.KEEP] = [1, 2]
    table[0, :, Part.SAMPLE, Said.REJECT] = [3, 1]
    table[0, :, Part.REST, Said.KEEP] = [0, 1]

    whole = estimate(table)

    exactly = Measured(0.75, 0.75, 0.75)
    assert (whole.precision, whole.recall, whole.f1) == (exactly, exactly, exactly)
    nothing, only_hidden = np.zeros((2, 1, 2, 3, 4), np.int64)
    only_hidden[0, 0, Part.SAMPLE, Said.REJECT] = 5
    assert estimate(nothing).precision is estimate(nothing).recall is None
    assert estimate(only_hidden).recall is estimate(only_hidden).f1 is None


@pytest.mark.parametrize("widest", [0.1, 0.05])
def test_plan_gives_about_the_interval_that_it_promises(widest):
    nothing_known = Reviewer(np.random.default_rng(5)).table()
    boxes, promised = plan(nothing_known, widest)
    reviewer = Reviewer(np.random.default_rng(6))
    reviewer.random(boxes)

    estimated = estimate(reviewer.table().sum(axis=0, keepdims=True))

    assert promised <= widest
    assert estimated.half_width == pytest.approx(promised, rel=0.35)
