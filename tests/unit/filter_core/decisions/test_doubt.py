"""Which boxes are asked about, which first, and why."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from filter_core.config.filter import FilterConfig
from filter_core.decisions.doubt import (
    BIN_NAMED,
    Bin,
    Cause,
    bins_of,
    doubts,
    questions,
)
from filter_core.decisions.rules import decide
from filter_core.evidence_numbers import BoxState, ChannelNumbers
from tests.support.evidence import evidence_of

TAGS = FilterConfig(profile="paper")
SIDE = 20.0


def box(match: float, *, side: float = SIDE, **more: object) -> dict[str, object]:
    """A square box with a match in percent; whole pixels are not needed here."""
    pixels = 400
    return {
        "xyxy": [0.0, 0.0, side, side],
        "match_percent": match,
        "box_pixels": pixels,
        "matched_pixels": round(pixels * match / 100),
        **more,
    }


def doubts_of(boxes, config=TAGS, **columns):
    channels = ChannelNumbers.absent(len(boxes))
    for name, numbers in columns.items():
        getattr(channels, name)[:] = numbers
    evidence = replace(evidence_of(boxes), channels=channels)
    decisions = decide(evidence, config)
    doubt = doubts(evidence, config, decisions)
    covering = dict.fromkeys(range(len(boxes)), "the nearer car 214")
    return doubt, questions(doubt, evidence, config, decisions, covering)


@pytest.mark.parametrize(
    ("seen", "bin_", "cause", "question"),
    [
        pytest.param(box(60, crowding=96), Bin.ASK, Cause.COVERED,
         "kept by its tags, but the nearer car 214 covers 96 % of it", id="covered"),
        pytest.param(box(60, crowding=40), Bin.SURE, Cause.NONE, None,
         id="more pixels match than the other box covers"),
        pytest.param(box(60), Bin.SURE, Cause.NONE, None, id="alone"),
        pytest.param(box(5), Bin.ASK, Cause.OWN_PIXELS,
         "rejected, but 20 of its pixels match, more than another box can have",
         id="own pixels"),
        pytest.param(box(9), Bin.ASK, Cause.OWN_PIXELS,
         "rejected, but 36 of its pixels match, more than another box can have",
         id="own pixels are likelier an error than a toss-up"),
        pytest.param(box(5, crowding=50), Bin.ASK, Cause.SOME_PIXELS,
         "rejected, but 20 of its pixels match", id="pixels of either"),
        pytest.param(box(0), Bin.WALL, Cause.NONE, None, id="wall"),
        pytest.param(box(11), Bin.ASK, Cause.TOSS_UP,
         "too few pixels to be certain on which side of the threshold it is",
         id="toss-up"),
        pytest.param(box(5, side=3.9), Bin.SMALL, Cause.NONE, None, id="small"),
        pytest.param(box(0, side=3.9), Bin.SMALL, Cause.NONE, None, id="small wall"),
        pytest.param(box(5, state=BoxState.OUTSIDE_IMAGE), Bin.SURE, Cause.NONE, None,
         id="outside"),
        pytest.param(box(5, measured=False), Bin.ASK, Cause.UNDECIDED,
         "nothing has decided whether it is visible", id="not measured"),
    ],
)  # fmt: skip
def test_box_has_its_bin_and_its_question(seen, bin_, cause, question):
    result, (sentence,) = doubts_of([seen])

    assert bins_of(result.doubt).tolist() == [bin_]
    assert result.cause.tolist() == [cause]
    assert sentence == question


def test_own_pixels_that_are_too_few_are_asked_about():
    config = FilterConfig(evidence="instance", min_visible_pixels=10)

    result, sentences = doubts_of(
        [box(60, crowding=96)] * 3, config, instance_pixels=[0, 9, 10]
    )

    assert bins_of(result.doubt).tolist() == [Bin.SURE, Bin.ASK, Bin.SURE]
    assert sentences[1] == (
        "rejected, but 9 of its own pixels can be seen, of the 10 that are needed"
    )


def test_kinds_of_evidence_that_disagree_are_the_doubt():
    instances, depth = [0, 0, 90, 90], [0, 90, 90, 0]

    result, sentences = doubts_of(
        [box(60)] * 4, FilterConfig(), instance_pixels=instances, depth_pixels=depth
    )

    disagreement = "instances and depth disagree about it"
    assert sentences == [None, disagreement, None, disagreement]
    assert result.doubt[1] > result.doubt[3] > 0


def test_what_is_too_small_follows_the_configuration():
    boxes = [box(5, side=side) for side in (3.9, 4.0, 9.9, 10.0)]
    larger = FilterConfig(profile="paper", review_min_side=10)

    by_default, _ = doubts_of(boxes)
    by_config, _ = doubts_of(boxes, larger)

    assert (by_default.doubt == Bin.SMALL).tolist() == [True, False, False, False]
    assert (by_config.doubt == Bin.SMALL).tolist() == [True, True, True, False]
    # What an eye can hardly decide comes last.
    hardly, _ = doubts_of([box(9.9, side=7.9), box(1.5, side=8)])
    assert hardly.cause.tolist() == [Cause.OWN_PIXELS, Cause.OWN_PIXELS]
    assert 0 < hardly.doubt[0] <= 10 < hardly.doubt[1]


BOX = st.builds(
    box,
    st.floats(0, 100),
    side=st.floats(1, 200),
    crowding=st.sampled_from([0.0, 30.0, 60.0, 99.0, 100.0]),
    unknown_pixels=st.sampled_from([0, 50]),
)
CONFIG = st.builds(
    FilterConfig,
    profile=st.sampled_from(["paper", "carlasimu"]),
    threshold_small_box=st.sampled_from([0, 10, 60]),
)


@given(boxes=st.lists(BOX, min_size=1, max_size=20), config=CONFIG)
def test_every_box_is_in_one_bin_whatever_the_others_are(boxes, config):
    together, _ = doubts_of(boxes, config)
    alone = [doubts_of([box], config)[0].doubt[0] for box in boxes]

    assert together.doubt.tolist() == alone
    assert set(bins_of(together.doubt).tolist()) <= set(Bin)
    assert together.doubt.max() <= 100
    assert ((together.cause != Cause.NONE) == (together.doubt > 0)).all()


@given(
    rejected=st.floats(0.5, 9.5), kept=st.floats(11, 100), crowding=st.floats(0, 100)
)
def test_pixels_are_less_likely_the_own_ones_the_more_another_box_covers(
    rejected, kept, crowding
):
    in_order = (0, crowding, 100)
    falling, _ = doubts_of([box(rejected, crowding=crowding) for crowding in in_order])
    rising, _ = doubts_of([box(kept, crowding=crowding) for crowding in in_order])

    assert falling.doubt.tolist() == sorted(falling.doubt, reverse=True)
    assert rising.doubt.tolist() == sorted(rising.doubt)


@given(match=st.floats(0.5, 9.5), sides=st.tuples(st.floats(4, 50), st.floats(4, 50)))
def test_an_eye_decides_better_about_a_larger_box(match, sides):
    result, _ = doubts_of([box(match, side=side) for side in sorted(sides)])

    assert result.doubt[0] <= result.doubt[1]


def test_bins_come_in_the_order_of_doubt():
    assert [bin_.label for bin_ in Bin] == list(BIN_NAMED)
    assert list(Bin) == sorted(Bin, reverse=True)
    doubt = np.array([-2, -1, 0, 1, 100], np.int16)
    assert bins_of(doubt).tolist() == [-2, -1, 0, 1, 1]
