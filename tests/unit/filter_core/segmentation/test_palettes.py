"""Tags, names and colours of each palette family, against CARLA's own tables."""

import json

import numpy as np
import pytest

from filter_core.segmentation.palettes import (
    FAMILIES,
    UnknownFamily,
    UnknownTag,
    UnknownVersion,
    family_of_version,
    palette_of,
)
from tests.support.pictures import tags_of
from tests.support.sources import CHECKOUT

ORACLE = json.loads((CHECKOUT / "tests" / "data" / "carla_palettes.json").read_text())


def test_palette_families_have_carlas_tags_names_and_colours():
    rows = {
        name: [
            {"tag": tag.tag, "name": tag.name, "rgb": list(tag.rgb)}
            for tag in family.tags
        ]
        for name, family in FAMILIES.items()
    }

    assert rows == ORACLE["families"]


@pytest.mark.parametrize("family", FAMILIES)
def test_every_tag_is_painted_in_a_colour_of_its_own(family):
    tags = np.arange(len(FAMILIES[family].tags), dtype=np.uint8).reshape(1, -1)

    painted = FAMILIES[family].paint(tags)

    np.testing.assert_array_equal(tags_of(painted, family), tags)
    # Unknown has a colour that no family has.
    unknown = FAMILIES["carla-0.9.14"].paint(np.array([[255, 77]], np.uint8))
    assert tags_of(unknown, family).tolist() == [[255, 255]]


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
def test_carla_version_maps_to_its_palette_family(version, family):
    assert family_of_version(version) == family


@pytest.mark.parametrize("version", ["", "nightly", "0.8.4", "0.11.0", "1.0", "9"])
def test_unknown_carla_version_raises_error_naming_it(version):
    with pytest.raises(UnknownVersion, match=f"found '{version}'"):
        family_of_version(version)


def test_tag_names_are_case_insensitive_and_unknown_ones_refused_with_a_list():
    assert FAMILIES["carla-0.9.14"].tag_of("trafficlight") == 7
    with pytest.raises(UnknownTag, match=r"carla-0\.9\.10 has no tag 'Car'; .*Vehicle"):
        FAMILIES["carla-0.9.10"].tag_of("Car")
    with pytest.raises(UnknownFamily, match=r"carla-0\.9\.14.*found 'carla-1'"):
        palette_of("carla-1")
    palette = FAMILIES["carla-0.9.10"]
    assert [palette.name_of(tag) for tag in (10, 23, 255)] == [
        "Vehicle",
        "Tag 23",
        "Unknown",
    ]
