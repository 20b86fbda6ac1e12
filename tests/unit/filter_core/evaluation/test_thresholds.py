"""Suggested thresholds for small sets of answers whose best threshold is obvious."""

import numpy as np
import pytest

from filter_core.evaluation.scores import Confusion
from filter_core.evaluation.thresholds import Answers, Goal, suggest


def answers(rejected, kept, **more):
    match = np.array([*rejected, *kept], np.float64)
    keep = np.arange(len(match)) >= len(rejected)
    return Answers(match, keep, **more)


@pytest.mark.parametrize(
    ("rejected", "kept", "current", "suggested"),
    [
        pytest.param([1, 2, 3], [20, 30], 10, 10, id="already right: stays"),
        pytest.param([1, 2, 12], [20, 30], 10, 16, id="middle of the gap"),
        pytest.param([1, 2, 3.1], [3.3, 30], 10, 3.2, id="as round as the gap allows"),
        pytest.param([50, 60], [70, 100], 10, 65, id="far away"),
        pytest.param([1, 2, 30], [20, 21, 40], 10, 10, id="what is in the way is less"),
    ],
)
def test_suggested_threshold_for_f1_separates_kept_from_rejected(
    rejected, kept, current, suggested
):
    suggestion = suggest(answers(rejected, kept), current, Goal())

    assert suggestion is not None
    assert suggestion.threshold == pytest.approx(suggested)
    assert suggestion.interval[0] <= suggestion.threshold <= suggestion.interval[1]
    assert (suggestion.at_suggested.f1 or 0) >= (suggestion.at_current.f1 or 0)


def test_recall_goal_gives_the_highest_threshold_that_reaches_it():
    kept = [5, *range(20, 119)]
    some = answers([1, 8, 15], [min(value, 100) for value in kept])

    all_of_them = suggest(some, 10, Goal("recall", 1.0))
    most = suggest(some, 10, Goal("recall", 0.99))

    assert all_of_them is not None
    assert most is not None
    assert 1 < all_of_them.threshold <= 5
    assert 15 < most.threshold <= 20
    assert most.at_suggested.recall == 0.99


def test_boxes_decided_without_a_threshold_count_in_every_score():
    some = answers([1], [20], others=Confusion(3, 1, 2, 5))

    suggestion = suggest(some, 10, Goal())

    assert suggestion is not None
    assert len(some) == 13
    assert suggestion.at_current.precision == 4 / 5
    assert suggestion.at_current.recall == 4 / 6


def test_match_equal_to_the_threshold_is_kept_unless_strict():
    met = suggest(answers([1], [10]), 10, Goal())
    strict = suggest(answers([1], [10], strict=True), 10, Goal())

    assert met is not None
    assert strict is not None
    assert met.at_current.recall == 1
    assert strict.at_current.recall == 0
    assert 1 <= strict.threshold < 10


@pytest.mark.parametrize(("rejected", "kept"), [([], []), ([1, 2], []), ([], [3])])
def test_answers_of_only_one_kind_give_no_suggestion(rejected, kept):
    assert suggest(answers(rejected, kept), 10, Goal()) is None


def test_interval_is_deterministic_and_narrows_with_more_answers():
    rng = np.random.default_rng(5)
    match = rng.uniform(0, 100, 5000)
    keep = rng.random(5000) < 1 / (1 + np.exp(-(match - 20) / 4))

    few, many, again = (
        suggest(Answers(match[:size], keep[:size]), 10, Goal())
        for size in (100, 5000, 5000)
    )

    assert few is not None
    assert many is not None
    assert many == again
    width = [best.interval[1] - best.interval[0] for best in (few, many)]
    assert width[1] < width[0] / 2
    # F1 is best where the chance of keep is half the best F1 (0.97): at 19.7 percent.
    assert many.interval[0] < 19.7 < many.interval[1]
    assert {10.0, many.threshold} <= {point.threshold for point in many.curve}
