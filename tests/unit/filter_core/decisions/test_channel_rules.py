"""A channel decides a box if it has a number for it, and reports what it compared."""

from dataclasses import replace

import numpy as np
import pytest

from filter_core.config.filter import FilterConfig
from filter_core.decisions.channel_rules import (
    channel_names,
    compared_by_channels,
    has_number,
    own_percent,
)
from filter_core.decisions.rules import decide
from filter_core.evidence_kinds import CHANNELS, SEMANTIC
from filter_core.evidence_numbers import BoxState, ChannelNumbers
from filter_core.verdicts import Reason
from tests.support.evidence import ACCEPTS_CAR, evidence_of


def measured(**columns):
    count = max(map(np.size, columns.values()))
    numbers = ChannelNumbers.absent(count)
    for name, values in columns.items():
        getattr(numbers, name)[:] = values
    return replace(evidence_of([{}] * count), channels=numbers)


@pytest.mark.parametrize("channel", CHANNELS)
def test_channel_without_a_measurement_does_not_decide(channel):
    evidence = replace(evidence_of([{}]), channels=ChannelNumbers.absent(1))
    config = FilterConfig(evidence=channel)

    decisions = decide(evidence, config)

    assert channel_names(decisions) == [None]
    assert np.isnan(compared_by_channels(evidence, config, decisions)).all()


def test_first_channel_with_a_measurement_decides():
    evidence = measured(
        instance_pixels=[4, -1, -1, -1],
        depth_pixels=[9, 7, -1, -1],
        owned_pixels=[9, 9, 5, -1],
        explained_by=[-1, -1, 3, -1],
    )
    config = FilterConfig(evidence="auto", min_visible_pixels=6, ordered_min_pixels=2)

    decisions = decide(evidence, config)
    number, needed = compared_by_channels(evidence, config, decisions)

    assert channel_names(decisions) == ["instance", "depth", "ordered", None]
    np.testing.assert_array_equal(number, [4, 7, 5, np.nan])
    np.testing.assert_array_equal(needed, [6, 6, 6, np.nan])
    instance, semantic = (
        has_number(evidence, "instance"),
        has_number(evidence, SEMANTIC),
    )
    assert instance.tolist() == [True, False, False, False]
    assert semantic.tolist() == [True] * 4


def test_box_rejected_by_an_earlier_rule_is_decided_by_no_channel():
    evidence = replace(
        measured(depth_pixels=[9, 9, 9, 9]),
        state=np.array([BoxState.OUTSIDE_IMAGE, 0, 0, 0], np.uint8),
        accept_mask=np.array([ACCEPTS_CAR, 0, ACCEPTS_CAR, ACCEPTS_CAR]),
        distance=np.array([20.0, 20.0, 300.0, 20.0]),
    )
    config = FilterConfig(evidence="depth", max_distance=200)

    decisions = decide(evidence, config)
    number, _ = compared_by_channels(evidence, config, decisions)

    assert channel_names(decisions) == [None] * 3 + ["depth"]
    np.testing.assert_array_equal(number, [np.nan] * 3 + [9])


@pytest.mark.parametrize(
    ("channel", "column"),
    [
        ("instance", "instance_pixels"),
        ("depth", "depth_pixels"),
        ("ordered", "owned_pixels"),
    ],
)
def test_share_of_own_pixels_decides_whatever_counts_them(channel, column):
    evidence = replace(
        measured(**{column: [3, 4, 9, 9]}),
        box_pixels=np.array([30, 40, 100, 30]),
        measured=np.array([True, True, True, False]),  # the last: by its area
        area_percent=np.array([1.0, 1.0, 1.0, 0.01]),
    )
    config = FilterConfig(
        evidence=channel, min_visible_percent=10, min_visible_pixels=4
    )

    decisions = decide(evidence, config)
    _, needed = compared_by_channels(evidence, config, decisions)

    assert (decisions.reason == Reason.VISIBLE).tolist() == [False, True, False, False]
    assert needed.tolist() == [4, 4, 10, 10]
    assert own_percent(evidence, config.channels).tolist() == [10, 10, 9, 9]


def test_share_of_own_pixels_is_that_of_the_deciding_channel():
    evidence = measured(
        instance_pixels=[100, -1, -1], owned_pixels=[50, 50, -1], center_gap=0.0
    )

    shares = [
        own_percent(evidence, FilterConfig(evidence=name).channels).tolist()
        for name in ("auto", "ordered", "depth_center", "semantic")
    ]

    nan = np.nan
    np.testing.assert_array_equal(
        shares, [[10, 5, nan], [5, 5, nan], [nan] * 3, [nan] * 3]
    )
