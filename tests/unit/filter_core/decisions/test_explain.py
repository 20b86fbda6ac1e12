"""The sentence that explains a decision, and how its percentages are rounded.

A percentage is never rounded to a value that would contradict the verdict.
"""

import pytest

from filter_core.config.filter import ClassLimits
from filter_core.decisions.explain import (
    ExplainedBox,
    explain,
    hidden_by,
    rounded_percent,
)
from filter_core.evidence_kinds import ChannelName
from filter_core.evidence_numbers import N_TAGS
from filter_core.segmentation.palettes import FAMILIES
from filter_core.verdicts import HiddenBy, Reason

COLOR = [107, 142, 35]
VEGETATION: HiddenBy = {"tag": 9, "name": "Vegetation", "rgb": COLOR, "percent": 71.2}


CHANNEL_OF: dict[Reason, ChannelName] = {
    Reason.EXPLAINED_BY_NEARER: "ordered",
    Reason.HIDDEN_BY_DEPTH: "depth",
    Reason.HIDDEN_BY_INSTANCE: "instance",
    Reason.TOO_FEW_LIDAR_POINTS: "lidar",
}
"""Reasons that only channels give, each with one channel that gives it."""


@pytest.mark.parametrize(
    ("reason", "numbers", "sentence"),
    [
        (Reason.BELOW_THRESHOLD,
         {"match_percent": 4.1, "threshold": 10, "hidden_by": [VEGETATION]},
         "rejected: 4.1 % of its pixels are Car, 10 % are needed; "
         "Vegetation covers 71 %"),
        (Reason.VISIBLE, {"match_percent": 74, "threshold": 10},
         "kept: 74 % of its pixels are Car, 10 % are needed"),
        (Reason.LARGE_BELOW_THRESHOLD,
         {"match_percent": 41, "threshold": 50, "area_percent": 83, "large": True},
         "rejected: it covers 83 % of the image and 41 % of its pixels are Car, "
         "50 % are needed"),
        (Reason.BELOW_THRESHOLD,
         {"match_percent": 10, "threshold": 10, "as_carlasimu": True},
         "rejected: 10 % of its pixels are Car, more than 10 % are needed"),
        # An ignore mask covers all of the box.
        (Reason.BELOW_THRESHOLD, {"threshold": 10},
         "rejected: none of its pixels count"),
        (Reason.NO_VISIBLE_PIXELS, {"matched_pixels": 0, "hidden_by": [VEGETATION]},
         "rejected: none of its pixels are Car; Vegetation covers 71 %"),
        (Reason.NO_VISIBLE_PIXELS, {"matched_pixels": 1, "pixels_needed": 5},
         "rejected: only 1 of its pixels is Car, 5 are needed"),
        (Reason.OUT_OF_RANGE,
         {"distance": 312.4, "limits": ClassLimits(max_distance=200)},
         "rejected: it is 312 m away, at most 200 m are allowed"),
        (Reason.OUT_OF_RANGE,
         {"distance": 4.996, "limits": ClassLimits(min_distance=5)},
         "rejected: it is 4.996 m away, at least 5 m are needed"),
        (Reason.UNMAPPED_CLASS, {},
         "unmeasured: no tag is accepted for the class 'car'"),
        (Reason.NO_SEGMENTATION, {},
         "unmeasured: there is no segmentation to measure with"),
        (Reason.OUTSIDE_IMAGE, {}, "rejected: the box lies outside the image"),
    ],
)  # fmt: skip
def test_explain_returns_the_sentence_of_a_decision(reason, numbers, sentence):
    box = ExplainedBox(reason, "car", accepted=("Car",), **numbers)

    assert explain(box) == sentence


def channel_sentence(channel, *, kept=False, **more):
    reason = Reason.VISIBLE if kept else Reason.NO_VISIBLE_PIXELS
    accepted = ("Car", "Truck")
    sentence = explain(
        ExplainedBox(reason, "car", accepted=accepted, channel=channel, **more)
    )
    return sentence.removeprefix(f"{reason.verdict.value}: ")


@pytest.mark.parametrize(
    ("sentence", "words"),
    [
        (channel_sentence("ordered", kept=True, number=1204, needed=3),
         "1,204 of its Car or Truck pixels belong to no nearer box"),
        (channel_sentence("ordered", number=0, nearer="car 217"),
         "its Car or Truck pixels belong to nearer boxes, above all car 217"),
        (channel_sentence("ordered", number=1, needed=3, nearer="car 217"),
         "only 1 of its Car or Truck pixels is left, 3 are needed; nearer boxes "
         "have the others, above all car 217"),
        (channel_sentence("ordered", number=0), "none of its pixels are Car or Truck"),
        (channel_sentence("ordered", number=2, needed=5),
         "only 2 of its pixels are Car or Truck, 5 are needed"),
        (channel_sentence("depth", kept=True, number=1),
         "1 of its Car or Truck pixels is at its own distance"),
        (channel_sentence("depth", number=0, depth_gap=12.3),
         "all Car or Truck pixels here are 12 m nearer than the box"),
        (channel_sentence("depth", number=0, depth_gap=-2.34),
         "all Car or Truck pixels here are 2.3 m behind the box"),
        (channel_sentence("depth", number=0), "none of its pixels are Car or Truck"),
        (channel_sentence("depth", number=2, needed=5, depth_gap=0.0),
         "only 2 of its Car or Truck pixels are at its own distance, 5 are needed"),
        (channel_sentence("depth_center", number=8.0),
         "what is seen at its centre is 8.0 m nearer than the box"),
        (channel_sentence("depth_center", kept=True, number=-3.0),
         "nothing nearer than the box is seen at its centre"),
        (channel_sentence("instance", number=0),
         "no instance in the image belongs to it"),
        (channel_sentence("instance", number=2, needed=5),
         "only 2 of the pixels of its instance are seen, 5 are needed"),
        (channel_sentence("instance", kept=True, number=412),
         "412 of the pixels of its own instance are seen"),
        (channel_sentence("lidar", number=0, needed=1),
         "no LiDAR points of Car or Truck lie inside it, 1 is needed"),
        (channel_sentence("lidar", number=0, needed=5),
         "no LiDAR points of Car or Truck lie inside it, 5 are needed"),
        (channel_sentence("lidar", number=1, needed=5),
         "only 1 LiDAR point of Car or Truck lies inside it, 5 are needed"),
        (channel_sentence("lidar", kept=True, number=51, needed=5),
         "51 LiDAR points of Car or Truck lie inside it, 5 are needed"),
        (channel_sentence("lidar", kept=True, number=0, needed=0),
         "0 LiDAR points of Car or Truck lie inside it, 0 are needed"),
        (channel_sentence("ordered", number=1204, needed=3000),
         "only 1204 of its pixels are Car or Truck, 3000 are needed"),
    ],
)  # fmt: skip
def test_explain_returns_the_sentence_of_a_channels_decision(sentence, words):
    assert sentence == words


@pytest.mark.parametrize("reason", list(Reason))
def test_explanation_of_every_reason_starts_with_its_verdict(reason):
    sentence = explain(ExplainedBox(reason, "car", channel=CHANNEL_OF.get(reason)))

    assert sentence.startswith(f"{reason.verdict.value}: ")
    assert "None" not in sentence


@pytest.mark.parametrize(
    ("value", "against", "text"),
    [
        (74.4, 10, "74 %"),
        (9.96, 10, "9.96 %"),
        (10.0004, 10, "10.0004 %"),
        (10, 10, "10 %"),
        (4.14, 10, "4.1 %"),
        (0, None, "0 %"),
        (0.004, None, "0.004 %"),
        (99.97, None, "99.97 %"),
        (100, None, "100 %"),
        (33.4, 33.3, "33.4 %"),
        (33.2, 33.3, "33 %"),
        (33.34, 33.3, "33.34 %"),
    ],
)
def test_percentage_is_not_rounded_to_or_across_the_threshold(value, against, text):
    assert rounded_percent(value, against) == text


def counts(**by_tag):
    row = [0] * N_TAGS
    for tag, pixels in by_tag.items():
        row[int(tag[1:])] = pixels
    return row


def test_hidden_by_lists_tags_that_the_class_does_not_accept():
    seen = counts(t14=10, t9=50, t3=20, t6=15, t5=4, t1=1)

    assert hidden_by(seen, 1 << 14, "carla-0.9.14") == [
        {"tag": 9, "name": "Vegetation", "rgb": [107, 142, 35], "percent": 50.0},
        {"tag": 3, "name": "Building", "rgb": [70, 70, 70], "percent": 20.0},
        {"tag": 6, "name": "Pole", "rgb": [153, 153, 153], "percent": 15.0},
    ]
    ground_and_sky = counts(t1=10, t2=10, t10=10, t11=10, t24=10, t25=10, t14=40)
    for row in (ground_and_sky, counts()):
        assert hidden_by(row, 1 << 14, "carla-0.9.14") == []
    building, unknown = hidden_by(counts(t30=5, t3=5), 0, "carla-0.9.14")
    assert (building["name"], unknown["name"]) == ("Building", "Unknown")
    assert unknown["rgb"] == [255, 255, 255]


@pytest.mark.parametrize("palette", FAMILIES.values(), ids=FAMILIES)
def test_hidden_by_has_the_colours_of_the_frames_palette(palette):
    for tag in palette.tags:
        row = counts(**{f"t{tag.tag}": 1})

        colours = [tag["rgb"] for tag in hidden_by(row, 0, palette.name)]

        assert colours in ([list(tag.rgb)], []), tag.name
