"""The rows of `unghost diff`: numbers that the server did not send stay empty."""

from unghost import Diff
from unghost.cli.remote.runs import rows_of

RESPONSE = {
    "run": 2,
    "against": 1,
    "compared": 9,
    "total": 3,
    "kept_to_rejected": 2,
    "rejected_to_kept": 0,
    "by_class": {"car": 2, "bus": 1},
}


def test_diff_rows_have_flips_per_class_in_both_directions():
    sides = {"car": {"kept_to_rejected": 2, "rejected_to_kept": 0}}

    rows = rows_of(Diff.read({**RESPONSE, "sides_by_class": sides}))

    assert rows == [("car", 2, 2, 0), ("bus", 1, 0, 0), ("all", 3, 2, 0)]
    without = rows_of(Diff.read(RESPONSE))
    assert without == [("car", 2, None, None), ("bus", 1, None, None), ("all", 3, 2, 0)]
