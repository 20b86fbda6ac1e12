"""Tags, names and colours of each palette family, against CARLA's own tables."""

import json

import numpy as np
import pytest

from filter_core.segmentation.palettes import (
    FAMILIES,
    UnknownPalette,
    UnknownTag,
    UnknownVersion,
    family_of_version,
    palette_of,
)
from tests.support.sources import CHECKOUT

ORACLE = json.loads((CHECKOUT / "tests" / "data" / "carla_palettes.json").read_text())


@pytest.mark.parametrize("family", ORACLE["families"])
def test_a_family_has_the_tags_names_and_colours_of_carla(family):
    rows = [
        {"tag": tag.tag, "name": tag.name, "rgb": list(tag.rgb)}
        for tag in FAMILIES[family].tags
    ]

    assert rows == ORACLE["families"][family]


def test_there_are_no_other_families():
    assert set(FAMILIES) == set(ORACLE["families"])


@pytest.mark.parametrize("family", FAMILIES)
def test_decoding_what_was_painted_gives_the_tags_back(family):
    tags = np.arange(len(FAMILIES[family].tags), dtype=np.uint8).reshape(1, -1)

    decoded = FAMILIES[family].decode(FAMILIES[family].paint(tags))

    np.testing.assert_array_equal(decoded, tags)


def test_a_colour_one_level_off_is_unknown():
    rgb = np.array([[[0, 0, 142], [0, 0, 141], [0, 1, 142]]], np.uint8)

    assert FAMILIES["carla-0.9.14"].decode(rgb).tolist() == [[14, 255, 255]]


def test_unknown_is_painted_with_a_colour_that_no_family_has():
    painted = FAMILIES["carla-0.9.14"].paint(np.array([[255, 77]], np.uint8))

    for palette in FAMILIES.values():
        assert palette.decode(painted).tolist() == [[255, 255]]


@pytest.mark.parametrize(
    ("version", "family"),
    [
        ("0.9.0", "carla-0.9.0"),
        ("0.9.9", "carla-0.9.0"),
        ("0.9.9.4", "carla-0.9.0"),
        ("0.9.10", "carla-0.9.10"),
        ("0.9.10.1", "carla-0.9.10"),
        ("0.9.13", "carla-0.9.10"),
        ("v0.9.13", "carla-0.9.10"),
        ("0.9.14", "carla-0.9.14"),
        ("0.9.14-12-g1a2b3c4-dirty", "carla-0.9.14"),
        ("0.9.16", "carla-0.9.14"),
        ("0.10", "carla-0.9.14"),
        ("0.10.0", "carla-0.9.14"),
    ],
)
def test_a_version_renders_a_family(version, family):
    assert family_of_version(version) == family


@pytest.mark.parametrize("version", ["", "nightly", "0.8.4", "0.11.0", "1.0", "9"])
def test_a_version_whose_tags_are_not_known_is_named_in_the_error(version):
    with pytest.raises(UnknownVersion, match=f"found '{version}'"):
        family_of_version(version)


def test_a_tag_has_a_name_even_if_the_family_gives_it_none():
    palette = FAMILIES["carla-0.9.10"]

    assert [palette.name_of(tag) for tag in (10, 23, 255)] == [
        "Vehicle",
        "Tag 23",
        "Unknown",
    ]


def test_tags_are_found_by_name_in_any_case():
    assert FAMILIES["carla-0.9.14"].tag_of("trafficlight") == 7


def test_a_name_that_a_family_lacks_is_an_error_that_lists_what_it_has():
    with pytest.raises(UnknownTag, match=r"carla-0\.9\.10 has no tag 'Car'; .*Vehicle"):
        FAMILIES["carla-0.9.10"].tag_of("Car")


def test_an_unknown_family_is_an_error_that_lists_the_known():
    with pytest.raises(UnknownPalette, match=r"carla-0\.9\.14.*found 'carla-1'"):
        palette_of("carla-1")
