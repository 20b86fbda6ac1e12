"""Counts that are summed from tallies, and which boxes need a review."""

from __future__ import annotations

import pytest

from app.boxes.counts import count, summary, tallies_of
from app.boxes.current import TallyKey
from app.verdicts import needs_review
from filter_core.types import Reason

SEEN, UNSEEN = int(Reason.VISIBLE), int(Reason.NO_VISIBLE_PIXELS)
BLIND, OUTSIDE = int(Reason.NO_SEGMENTATION), int(Reason.OUTSIDE_IMAGE)


@pytest.mark.parametrize(
    ("reason", "toss_up", "review", "waits"),
    [
        pytest.param(SEEN, False, None, False, id="kept"),
        pytest.param(SEEN, True, None, True, id="kept by a hair"),
        pytest.param(SEEN, True, "keep", False, id="decided by a person"),
        pytest.param(UNSEEN, False, None, True, id="rejected by its pixels"),
        pytest.param(UNSEEN, False, "unsure", True, id="a person was unsure"),
        pytest.param(UNSEEN, False, "reject", False, id="a person agreed"),
        pytest.param(BLIND, False, None, True, id="not measured"),
        pytest.param(OUTSIDE, False, None, False, id="nothing to see"),
        pytest.param(int(Reason.DEGENERATE), False, None, False, id="no extent"),
        pytest.param(int(Reason.UNMAPPED_CLASS), False, None, True, id="no class"),
    ],
)
def test_needs_review_only_for_boxes_that_a_person_can_judge(
    reason, toss_up, review, waits
):
    assert needs_review(reason, toss_up, review) is waits


def test_tallies_are_summed_by_verdict_reason_class_and_conflict():
    counts = count(
        {
            TallyKey(1, SEEN, False, ""): 10,
            TallyKey(1, SEEN, True, "reject"): 3,
            TallyKey(1, UNSEEN, False, "keep"): 2,
            TallyKey(2, UNSEEN, False, "reject"): 1,
            TallyKey(2, BLIND, False, "unsure"): 4,
        }
    )

    assert summary(counts) == {
        "boxes": 20,
        "kept": 13,
        "rejected": 3,
        "unmeasured": 4,
        "reviewed": 6,
        "to_review": 4,
    }
    assert counts.effective == {"kept": 12, "rejected": 4, "unmeasured": 4}
    assert (counts.conflicts, counts.unsure, counts.toss_ups) == (5, 4, 3)
    assert counts.by_reason == {
        "visible": 13,
        "no_visible_pixels": 3,
        "no_segmentation": 4,
    }
    assert counts.by_class == {
        1: {"kept": 13, "rejected": 2, "unmeasured": 0},
        2: {"kept": 0, "rejected": 1, "unmeasured": 4},
    }
    assert counts.reasons_by_class == {
        1: {"visible": 13, "no_visible_pixels": 2},
        2: {"no_visible_pixels": 1, "no_segmentation": 4},
    }


def test_tallies_of_counts_equal_boxes():
    rows = [(1, SEEN, False, None), (1, SEEN, False, "keep"), (1, SEEN, False, None)]

    assert tallies_of(rows) == {
        TallyKey(1, SEEN, False, ""): 2,
        TallyKey(1, SEEN, False, "keep"): 1,
    }
