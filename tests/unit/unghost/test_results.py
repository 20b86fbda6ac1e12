"""Results are read from JSON that an older or newer server wrote."""

from __future__ import annotations

from dataclasses import FrozenInstanceError
from datetime import datetime, timezone

import pytest

from unghost import Dataset, Decision, Frame, HistoryEntry
from unghost.reading import MissingKey

DECISION = {
    "id": "217",
    "class": "car",
    "verdict": "rejected",
    "reason": "below_threshold",
    "hidden_by": [{"tag": 9, "name": "Vegetation", "percent": 71.0}],
    "review": {"verdict": "keep", "revision": 2, "reviewer": "ada", "comment": None},
    "edges": None,
}


def test_nested_objects_become_typed_values():
    decision = Decision.read(DECISION)

    assert decision.class_name == "car"
    assert decision.hidden_by[0].name == "Vegetation"
    assert decision.review is not None
    assert decision.review.revision == 2
    assert decision.edges is None


def test_mappings_of_objects_become_mappings_of_typed_values():
    frame = Frame.read(
        {"id": 1, "key": "a", "files": {"image": {"url": "/x", "sha256": "ab"}}}
    )

    assert frame.files["image"].sha256 == "ab"


def test_unknown_keys_are_no_error_and_are_kept_in_raw():
    dataset = Dataset.read({"name": "town", "colour_of_the_sky": "blue"})

    assert dataset.name == "town"
    assert dataset.raw["colour_of_the_sky"] == "blue"


def test_null_means_the_default():
    dataset = Dataset.read({"name": "town", "counts": None, "classes": None})

    assert dataset.counts.frames == 0
    assert dataset.classes == ()


def test_a_key_that_must_be_there_is_named():
    with pytest.raises(MissingKey, match="Dataset lacks 'name'"):
        Dataset.read({})


def test_times_are_aware():
    dataset = Dataset.read({"name": "town", "created_at": "2026-01-01T00:00:00Z"})

    assert dataset.created_at == datetime(2026, 1, 1, tzinfo=timezone.utc)


def test_results_are_frozen_and_equal_by_value():
    first, second = Decision.read(DECISION), Decision.read({**DECISION, "new": 1})

    assert first == second
    with pytest.raises(FrozenInstanceError):
        del first.verdict


def test_a_decision_whose_numbers_are_gone_has_a_place_in_a_history():
    raw = {"kind": "decision", "at": "2026-01-01T00:00:00Z", "run": 3, "verdict": None}

    entry = HistoryEntry.read(raw)

    assert (entry.run, entry.verdict) == (3, None)
