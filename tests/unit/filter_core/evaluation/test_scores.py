"""Precision, recall, F1 and their intervals, against textbooks and definitions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from filter_core.evaluation.scores import (
    BANDS,
    Confusion,
    band_index,
    wilson_interval,
)


@pytest.mark.parametrize(
    ("part", "whole", "low", "high"),
    [(0, 10, 0.0, 0.2775), (5, 10, 0.2366, 0.7634), (10, 10, 0.7225, 1.0)],
)
def test_wilson_interval_equals_published_values(part, whole, low, high):
    assert wilson_interval(part, whole) == pytest.approx((low, high), abs=5e-5)


@given(*[st.integers(0, 200)] * 4)
def test_precision_recall_and_f1_are_correct_and_in_their_intervals(tp, fp, fn, tn):
    scores = Confusion(tp, fp, fn, tn)

    three = scores.precision, scores.recall, scores.f1
    assert scores.boxes == tp + fp + fn + tn
    wholes = (tp + fp, tp + fn, tp + fp + fn)
    assert [score is None for score in three] == [whole == 0 for whole in wholes]
    if tp:
        precision, recall = tp / (tp + fp), tp / (tp + fn)
        f1 = 2 * precision * recall / (precision + recall)
        values = [score.value for score in three if score is not None]
        assert values == pytest.approx([precision, recall, f1])
    for score in three:
        if score is not None:
            assert 0 <= score.low <= score.value <= score.high <= 1


@given(
    st.lists(st.tuples(st.booleans(), st.booleans()), max_size=30), st.integers(0, 30)
)
def test_confusions_of_parts_add_up_to_the_total(boxes, cut):
    kept, visible = np.array(boxes, bool).reshape(-1, 2).T

    parts = Confusion.of(kept[:cut], visible[:cut]) + Confusion.of(
        kept[cut:], visible[cut:]
    )

    assert parts == Confusion.of(kept, visible)
    assert parts.kept_hidden == sum(k and not v for k, v in boxes)


def test_distance_band_includes_its_lower_bound():
    metres = np.array([0, 49.99, 50, 150, 200, 1e6, np.nan])

    bands = [BANDS[index] for index in band_index(metres)]

    assert bands == ["0-50", "0-50", "50-100", "150-200", ">200", ">200", "unknown"]
