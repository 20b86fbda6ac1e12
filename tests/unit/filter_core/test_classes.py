"""The class of each blueprint, and the tags that count for each class."""

import json

import numpy as np
import pytest

from filter_core.class_names import BLUEPRINT_CLASS, class_of
from filter_core.classes import accept_mask_of, accepted_names, accepts
from filter_core.config.filter import FilterConfig
from filter_core.errors import ConfigError
from tests.support.shared_data import shared


def bits(*tags):
    return sum(1 << tag for tag in tags)


def test_every_accept_set_and_blueprint_class_equals_the_oracle():
    oracle = json.loads(shared("oracles/carla_palettes.json").read_text())

    for family, classes in oracle["accept_tags"].items():
        for name, tags in classes.items():
            assert accept_mask_of(name, family) == bits(*tags), (family, name)
    expected = {row["blueprint"]: row["base_type"] for row in oracle["vehicles"]}
    assert expected == BLUEPRINT_CLASS


@pytest.mark.parametrize(
    ("name", "family", "profile", "expected"),
    [
        ("car", "carla-0.9.14", "paper", bits(14)),
        ("van", "carla-0.9.14", "paper", bits(14, 15)),
        ("motorcycle", "carla-0.9.14", "paper", bits(13, 18)),
        ("street_light", "carla-0.9.14", "paper", bits(7)),
        ("traffic_light", "carla-0.9.0", "paper", 0),
        ("bicycle", "carla-0.9.10", "paper", bits(4, 10)),
        ("truck", "paper-table1", "paper", bits(1)),
        ("van", "paper-table1", "paper", bits(3)),
        ("vehicle", "paper-table1", "paper", 0),
        ("truck", "carla-0.9.14", "carlasimu", bits(14)),
        ("motorcycle", "carla-0.9.14", "carlasimu", bits(18)),
        ("street_light", "carla-0.9.14", "carlasimu", bits(7)),
        ("bus", "carla-0.9.10", "carlasimu", 0),
        ("bus", None, "paper", bits(16)),
        ("unknown", "carla-0.9.14", "paper", 0),
        ("unknown", None, "carlasimu", 0),
    ],
)
def test_accept_mask_by_class_family_and_profile(name, family, profile, expected):
    assert accept_mask_of(name, family, profile) == expected


@pytest.mark.parametrize(
    ("type_id", "base_type", "expected"),
    [
        ("vehicle.ford.ambulance", "car", "van"),
        ("vehicle.tesla.cybertruck", None, "truck"),
        ("vehicle.ambulance.ford", "van", "van"),
        ("vehicle.ambulance.ford", None, None),
        ("vehicle.ambulance.ford", "hovercraft", None),
        ("walker.pedestrian.0001", None, "walker"),
        ("traffic.traffic_light", None, "traffic_light"),
        ("traffic.traffic_light.large", None, "traffic_light"),
        ("traffic.stop", None, None),
        ("static.prop.trashcan", None, None),
        ("walkers", None, None),
        (None, "bus", "bus"),
        (None, None, None),
    ],
)
def test_class_of_an_actor_by_type_id_and_base_type(type_id, base_type, expected):
    assert class_of(type_id, base_type) == expected


def test_accept_override_takes_tag_names_and_numbers_of_the_family():
    config = FilterConfig.from_mapping(
        {"classes": {"van": {"accept": ["Truck", 14]}, "sign": {"accept": [8]}}}
    ).measuring()

    masks = config.accept_masks(["van", "sign", "car"], "carla-0.9.14")

    assert masks.tolist() == [bits(14, 15), bits(8), bits(14)]
    assert config.accept_masks(["van"], None).tolist() == [bits(14, 15)]
    with pytest.raises(ConfigError, match=r"carla-0\.9\.10 has no tag 'Truck'"):
        config.accept_masks(["van"], "carla-0.9.10")
    assert accepted_names(bits(13, 18), "carla-0.9.14") == ("Rider", "Motorcycle")
    assert accepted_names(0, "carla-0.9.14") == ()


@pytest.mark.parametrize("mask", [0, 1, 1 << 29, 0b101 << 13, (1 << 63) - 1], ids=hex)
def test_accepts_is_true_for_known_tags_whose_bit_is_set(mask):
    tags = np.arange(256, dtype=np.uint8)
    expected = [tag <= 29 and bool(mask >> tag & 1) for tag in range(256)]

    assert accepts(mask, tags).tolist() == expected
    assert accepts(np.array([[mask], [0]]), tags).tolist() == [expected, [False] * 256]
