"""The rows of `unghost diff`: numbers that the server did not send stay empty."""

from __future__ import annotations

from unghost import Diff
from unghost.cli.runs import rows_of

ANSWER = {
    "run": 2,
    "against": 1,
    "compared": 9,
    "total": 3,
    "kept_to_rejected": 2,
    "rejected_to_kept": 0,
    "by_class": {"car": 2, "bus": 1},
}


def test_each_class_has_its_ways():
    sides = {"car": {"kept_to_rejected": 2, "rejected_to_kept": 0}}

    rows = rows_of(Diff.read({**ANSWER, "sides_by_class": sides}))

    assert rows == [("car", 2, 2, 0), ("bus", 1, 0, 0), ("all", 3, 2, 0)]


def test_a_server_that_does_not_tell_the_ways_leaves_them_open():
    rows = rows_of(Diff.read(ANSWER))

    assert rows == [("car", 2, None, None), ("bus", 1, None, None), ("all", 3, 2, 0)]
