"""Cohen's kappa against textbook values, and agreement of people on the same boxes."""

import numpy as np
import pytest

from filter_core.evaluation.agreement import agreement, cohen_kappa


@pytest.mark.parametrize(
    ("table", "kappa", "error"),
    [
        # J. L. Fleiss, Statistical Methods for Rates and Proportions, 2nd ed., p. 219.
        pytest.param([[75, 1, 4], [5, 4, 1], [0, 0, 10]], 0.676, 0.0877, id="Fleiss"),
        # J. Cohen 1960 has three categories of proportions; n = 200.
        pytest.param(
            [[88, 14, 18], [10, 40, 10], [2, 6, 12]], 0.492, None, id="Cohen 1960"
        ),
        pytest.param([[20, 5], [10, 15]], 0.4, None, id="two of two"),
        pytest.param([[0, 7], [7, 0]], -1.0, 0.0, id="always opposed"),
        pytest.param([[3, 0], [0, 9]], 1.0, 0.0, id="always alike"),
    ],
)
def test_cohen_kappa_equals_published_values(table, kappa, error):
    measured = cohen_kappa(np.array(table))

    assert measured is not None
    assert measured.value == pytest.approx(kappa, abs=5e-4)
    assert -1 <= measured.low <= measured.value <= measured.high <= 1
    if error is not None:
        assert measured.value - max(-1, measured.low) == pytest.approx(
            min(1.959964 * error, measured.value + 1), abs=5e-4
        )


@pytest.mark.parametrize("table", [[[0, 0], [0, 0]], [[5, 0], [0, 0]]])
def test_cohen_kappa_is_none_if_all_answers_are_equal(table):
    assert cohen_kappa(np.array(table)) is None
    nothing = np.empty(0, np.int64)
    result = agreement(nothing, nothing, nothing.astype(bool))
    assert (result.boxes, result.agreed, result.pairs, result.kappa) == (0, 0, [], None)
