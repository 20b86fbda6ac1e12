"""Sentences about boxes that another channel than the segmentation judged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from filter_core.config.filter import FilterConfig
from filter_core.decisions.channel_rules import (
    ChannelJudgement,
    explain_channel,
    has_number,
    judged_by,
)
from filter_core.decisions.rules import decide
from filter_core.evidence_kinds import CHANNELS, SEMANTIC
from filter_core.types import BoxState, ChannelNumbers
from tests.support.evidence import ACCEPTS_CAR, evidence_of


def said(channel, *, kept=False, **more):
    return explain_channel(
        ChannelJudgement(channel, kept, accepted=("Car", "Truck"), **more)
    )


@pytest.mark.parametrize(
    ("sentence", "words"),
    [
        (
            said("ordered", kept=True, number=1204, needed=3),
            "1,204 of its Car or Truck pixels are not explained by nearer boxes",
        ),
        (
            said("ordered", number=0, nearer="car 217"),
            "explained by the nearer car 217",
        ),
        (
            said("ordered", number=1, needed=3, nearer="car 217"),
            "explained by the nearer car 217; 1 of its pixels is left, 3 are needed",
        ),
        (said("ordered", number=0), "none of its pixels are Car or Truck"),
        (
            said("ordered", number=2, needed=5),
            "only 2 of its pixels are Car or Truck, 5 are needed",
        ),
        (
            said("depth", kept=True, number=1),
            "1 of its Car or Truck pixels is at its own distance",
        ),
        (
            said("depth", number=0, depth_gap=12.3),
            "all Car or Truck pixels here are 12 m nearer than the box",
        ),
        (
            said("depth", number=0, depth_gap=-2.34),
            "all Car or Truck pixels here are 2.3 m behind the box",
        ),
        (said("depth", number=0), "none of its pixels are Car or Truck"),
        (
            said("depth", number=2, needed=5, depth_gap=0.0),
            "only 2 of its Car or Truck pixels are at its own distance, 5 are needed",
        ),
        (
            said("depth_center", number=8.0),
            "what is seen at its centre is 8.0 m nearer than the box",
        ),
        (
            said("depth_center", kept=True, number=-3.0),
            "nothing nearer than the box is seen at its centre",
        ),
        (said("instance", number=0), "no instance in the image belongs to it"),
        (
            said("instance", number=2, needed=5),
            "only 2 of the pixels of its instance are seen, 5 are needed",
        ),
        (
            said("instance", kept=True, number=412),
            "412 of the pixels of its own instance are seen",
        ),
        (
            said("lidar", number=0, needed=5),
            "no LiDAR points of Car or Truck lie inside it, 5 are needed",
        ),
        (
            said("lidar", number=1, needed=5),
            "only 1 LiDAR point of Car or Truck lies inside it, 5 are needed",
        ),
        (
            said("lidar", kept=True, number=51, needed=5),
            "51 LiDAR points of Car or Truck lie inside it, 5 are needed",
        ),
        (
            said("lidar", kept=True, number=0, needed=0),
            "0 LiDAR points of Car or Truck lie inside it, 0 are needed",
        ),
        (
            said("ordered", number=1204, needed=3000),
            "only 1204 of its pixels are Car or Truck, 3000 are needed",
        ),
    ],
)
def test_a_channels_decision_in_one_sentence(sentence, words):
    assert sentence == words


def measured(**columns):
    count = max(map(len, columns.values()))
    numbers = ChannelNumbers.absent(count)
    for name, values in columns.items():
        getattr(numbers, name)[:] = values
    return replace(evidence_of([{}] * count), channels=numbers)


@pytest.mark.parametrize("channel", CHANNELS)
def test_every_channel_of_a_configuration_judges(channel):
    evidence = replace(evidence_of([{}]), channels=ChannelNumbers.absent(1))
    config = FilterConfig(evidence=channel)

    judged = judged_by(evidence, config, decide(evidence, config))

    assert judged.channel == ["semantic"]
    assert np.isnan([judged.number, judged.needed]).all()
    assert said(channel, kept=True, number=0)


def test_the_first_channel_with_a_number_judges():
    evidence = measured(
        instance_pixels=[4, -1, -1, -1],
        depth_pixels=[9, 7, -1, -1],
        owned_pixels=[9, 9, 5, -1],
        explained_by=[-1, -1, 3, -1],
    )
    config = FilterConfig(evidence="auto", min_visible_pixels=6, ordered_min_pixels=2)

    judged = judged_by(evidence, config, decide(evidence, config))

    assert judged.channel == ["instance", "depth", "ordered", "semantic"]
    np.testing.assert_array_equal(judged.number, [4, 7, 5, np.nan])
    np.testing.assert_array_equal(judged.needed, [6, 6, 2, np.nan])
    instance, semantic = (
        has_number(evidence, "instance"),
        has_number(evidence, SEMANTIC),
    )
    assert instance.tolist() == [True, False, False, False]
    assert semantic.tolist() == [True] * 4


def test_a_box_that_is_rejected_before_channels_are_asked_is_judged_by_none():
    evidence = replace(
        measured(depth_pixels=[9, 9, 9, 9]),
        state=np.array([BoxState.OUTSIDE_IMAGE, 0, 0, 0], np.uint8),
        accept_mask=np.array([ACCEPTS_CAR, 0, ACCEPTS_CAR, ACCEPTS_CAR]),
        distance=np.array([20.0, 20.0, 300.0, 20.0]),
    )
    config = FilterConfig(evidence="depth", max_distance=200)

    judged = judged_by(evidence, config, decide(evidence, config))

    assert judged.channel == ["semantic"] * 3 + ["depth"]
    np.testing.assert_array_equal(judged.number, [np.nan] * 3 + [9])
