"""The present code gives every pinned value; `tests.pins` explains what pins are."""

import copy
from typing import Any

import pytest

from tests.pins import stored
from tests.pins.pinned import PINS


def with_stored_limits(name: str, value: Any) -> Any:
    """The found value, in which fewer modules of our own count as the stored number."""
    if name != "modules":
        return value
    limits = stored.read(name)
    value = copy.deepcopy(value)
    for statement, loaded in value.items():
        limit = limits.get(statement, {}).get("own modules", 0)
        loaded["own modules"] = max(loaded["own modules"], limit)
    return value


@pytest.mark.parametrize("name", PINS)
def test_every_pinned_output_is_unchanged(name):
    complaint = stored.complaint(name, with_stored_limits(name, PINS[name]()))

    assert not complaint, complaint


def test_every_stored_file_belongs_to_a_pin():
    assert {path.stem for path in stored.FOLDER.iterdir()} == set(PINS)


@pytest.mark.parametrize(
    ("before", "now", "words"),
    [
        ({"a": {"b": 1}}, {"a": {"b": 2}}, "a > b: it was 1, it is 2"),
        ({"a": 1}, {"a": 1.0}, "a: it was 1, it is 1.0"),
        ({"a": 1}, {}, "a: it was 1, it is absent"),
        (
            {"a": 1, "b": 2},
            {"b": 2, "a": 1},
            "order of the keys differs: at 0 it was 'a'",
        ),
        ([{"step": "go", "x": 1}], [{"step": "go", "x": 2}], "[0: go] > x: it was 1"),
        ([1, 2], [1], "there were 2, there are 1"),
        (["a", "b"], ["b", "c"], "gone ['a'], new ['c']"),
        (["a", "b"], ["b", "a"], "the order differs: at 0 it was 'a', it is 'b'"),
    ],
)
def test_difference_is_reported_with_its_place(before, now, words):
    (told,) = stored.differences(before, now)

    assert words in told
    assert list(stored.differences(before, before)) == []
