"""The choices of the command line are those of the library."""

from __future__ import annotations

import pytest

from filter_core.config.keys import CHOICES
from filter_core.segmentation.palettes import FAMILIES
from unghost.cli.source_options import (
    ChannelOrder,
    Encoding,
    Lossy,
    Palette,
    SegmentationReading,
    SourceOptions,
)


def values(choices):
    return [choice.value for choice in choices]


def test_every_palette_can_be_chosen():
    assert set(values(Palette)) == {"auto", *FAMILIES}


@pytest.mark.parametrize(
    ("choices", "key"),
    [
        (Palette, "palette"),
        (Encoding, "encoding"),
        (ChannelOrder, "channel_order"),
        (Lossy, "lossy_segmentation"),
    ],
)
def test_choices_are_those_of_the_configuration(choices, key):
    assert set(values(choices)) == set(CHOICES[key])


def test_only_what_was_said_is_passed_on():
    said = SegmentationReading(palette=Palette.CARLA_0_9_14, lossy_segmentation=None)

    assert said.reading == {"palette": "carla-0.9.14"}


def test_class_names_are_separated_by_commas():
    assert SourceOptions(classes="car, traffic light").class_list == (
        "car",
        "traffic light",
    )
    assert SourceOptions().class_list is None
