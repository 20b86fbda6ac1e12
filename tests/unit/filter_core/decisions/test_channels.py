"""Sentences about boxes that another channel than the segmentation judged."""

from __future__ import annotations

import pytest

from filter_core.decisions.channels import ChannelJudgement, explain_channel


def said(channel, *, kept=False, **more):
    return explain_channel(
        ChannelJudgement(channel, kept, accepted=("Car", "Truck"), **more)
    )


@pytest.mark.parametrize(
    ("sentence", "words"),
    [
        (
            said("ordered", kept=True, count=1204, needed=3),
            "1,204 of its Car or Truck pixels are not explained by nearer boxes",
        ),
        (
            said("ordered", count=0, explained_by="car 217"),
            "explained by the nearer car 217",
        ),
        (
            said("ordered", count=1, needed=3, explained_by="car 217"),
            "explained by the nearer car 217; 1 of its pixels is left, 3 are needed",
        ),
        (said("ordered", count=0), "none of its pixels are Car or Truck"),
        (
            said("ordered", count=2, needed=5),
            "only 2 of its pixels are Car or Truck, 5 are needed",
        ),
        (
            said("depth", kept=True, count=1),
            "1 of its Car or Truck pixels is at its own distance",
        ),
        (
            said("depth", count=0, gap=12.3),
            "all Car or Truck pixels here are 12 m nearer than the box",
        ),
        (
            said("depth", count=0, gap=-2.34),
            "all Car or Truck pixels here are 2.3 m behind the box",
        ),
        (said("depth", count=0), "none of its pixels are Car or Truck"),
        (
            said("depth", count=2, needed=5, gap=0.0),
            "only 2 of its Car or Truck pixels are at its own distance, 5 are needed",
        ),
        (
            said("depth_center", gap=8.0),
            "what is seen at its centre is 8.0 m nearer than the box",
        ),
        (
            said("depth_center", kept=True, gap=-3.0),
            "nothing nearer than the box is seen at its centre",
        ),
        (said("instance", count=0), "no instance in the image belongs to it"),
        (
            said("instance", count=2, needed=5),
            "only 2 of the pixels of its instance are seen, 5 are needed",
        ),
        (
            said("instance", kept=True, count=412),
            "412 of the pixels of its own instance are seen",
        ),
        (
            said("lidar", count=0, needed=5),
            "no LiDAR points of Car or Truck lie inside it, 5 are needed",
        ),
        (
            said("lidar", count=1, needed=5),
            "only 1 LiDAR point of Car or Truck lies inside it, 5 are needed",
        ),
        (
            said("lidar", kept=True, count=51, needed=5),
            "51 LiDAR points of Car or Truck lie inside it, 5 are needed",
        ),
    ],
)
def test_a_channels_decision_in_one_sentence(sentence, words):
    assert sentence == words
