"""Counts that are summed from tallies."""

from app.boxes.counts import count, summary, tallies_of
from app.boxes.filter import TallyKey
from filter_core.decisions.doubt import Bin
from filter_core.verdicts import Reason

SEEN, UNSEEN = int(Reason.VISIBLE), int(Reason.NO_VISIBLE_PIXELS)
BLIND = int(Reason.NO_SEGMENTATION)


def test_tallies_are_summed_by_verdict_reason_class_and_conflict():
    counts = count(
        {
            TallyKey(1, SEEN, False, Bin.SURE, ""): 8,
            TallyKey(1, SEEN, False, Bin.ASK, ""): 2,
            TallyKey(1, SEEN, True, Bin.ASK, "reject"): 3,
            TallyKey(1, UNSEEN, False, Bin.WALL, "keep"): 2,
            TallyKey(2, UNSEEN, False, Bin.ASK, "reject"): 1,
            TallyKey(2, BLIND, False, Bin.ASK, "unsure"): 4,
        }
    )

    assert summary(counts) == {
        "boxes": 20,
        "kept": 13,
        "rejected": 3,
        "unmeasured": 4,
        "reviewed": 6,
        "to_review": 6,
    }
    assert counts.bins == {"ask": 6, "sure": 8, "small": 0, "wall": 0}
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
    answers = [(7, None), (30, "keep"), (1, None), (-2, None)]

    assert tallies_of((1, SEEN, False, *each) for each in answers) == {
        TallyKey(1, SEEN, False, Bin.ASK, ""): 2,
        TallyKey(1, SEEN, False, Bin.ASK, "keep"): 1,
        TallyKey(1, SEEN, False, Bin.WALL, ""): 1,
    }
