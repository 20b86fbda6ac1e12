"""The filter's configuration: defaults, digests, limits, faults and JSON schema."""

import hashlib
import json
import pickle
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from filter_core.config.declaration import (
    INHERIT,
    AllowedScale,
    ChangedTagNames,
    NumberRange,
    counted,
    key,
)
from filter_core.config.filter import (
    ClassConfig,
    ClassLimits,
    ConfigChange,
    DecideConfig,
    FilterConfig,
    diff_configs,
    schema_of,
)
from filter_core.config.keys import ClassKeys, keys_of
from filter_core.decisions.rules import decide
from filter_core.errors import ConfigError
from filter_core.evidence_kinds import CHANNELS, SEMANTIC
from filter_core.evidence_numbers import ChannelNumbers
from tests.support.evidence import evidence_of

NUMBERS = [
    name
    for name, key in keys_of(ClassConfig).items()
    if isinstance(key.allowed, NumberRange)
]


def test_empty_configuration_has_every_default():
    """The default values, and their order, are pinned in tests/pins."""
    defaults = {name: key.default for name, key in keys_of(FilterConfig).items()}

    assert FilterConfig().as_dict() == {**defaults, "classes": {}}
    # Otherwise the arrays by class (`limits_by_class`) would lack a key.
    keys = keys_of(ClassKeys).values()
    assert all(isinstance(key.allowed, NumberRange) for key in keys)


@dataclass(frozen=True, kw_only=True, eq=False)
class WithNewKey(FilterConfig):
    """A configuration with one more key than today's."""

    min_side: int = key(counted("pixels"), 2, "Shortest side of a box.")


@pytest.mark.parametrize(
    "keys", [{}, {"max_distance": 80, "classes": {"van": {"min_visible_pixels": 2}}}]
)
def test_new_key_changes_the_digest_only_with_another_value(keys):
    stored = FilterConfig.from_mapping(keys)

    new, same, other, another = (
        WithNewKey.from_mapping({**keys, **more}).digest
        for more in ({}, {"min_side": 2.0}, {"min_side": 3}, {"min_side": 4})
    )

    assert new == same == stored.digest
    assert len({new, other, another}) == 3
    assert WithNewKey().as_dict()["min_side"] == 2


FIRST_KEYS = {
    "profile": "paper",
    "threshold_small_box": 10,
    "size_big_box": 70,
    "threshold_big_box": 50,
    "min_visible_pixels": 1,
    "min_distance": None,
    "max_distance": None,
    "evidence": "semantic",
    "projection": "clipped",
    "depth_tolerance": 0.15,
    "ordered_min_pixels": 3,
    "lidar_min_points": 5,
    "palette": "auto",
    "encoding": "auto",
    "channel_order": "auto",
    "lossy_segmentation": "refuse",
    "classes": {},
}
"""The keys that every digest contains, even at their default. Never add one."""

DEFAULTS_OF_NEW_KEYS: dict[str, object] = {
    "review_min_side": 4,
    "depth_encoding": "auto",
    "tags": {},
    "tag_scale": "auto",
    "min_visible_percent": 0,
    "min_forward": None,
}
"""The defaults of all later keys. Such a default must never change again."""


def test_default_digest_is_that_of_the_first_keys_and_no_later_default_changes():
    """A digest leaves out a new key that has its default.

    If that default changed, the same digest would mean two configurations.
    """
    strongest = {**FIRST_KEYS, "evidence": "auto", "min_visible_pixels": 10}
    for profile, keys in (("paper", FIRST_KEYS), ("", strongest)):
        text = json.dumps(keys, sort_keys=True, separators=(",", ":"))
        digest = hashlib.sha256(text.encode()).hexdigest()
        options = {"profile": profile} if profile else {}
        assert FilterConfig.from_mapping(options).digest == digest
    new = {
        name: key.default
        for name, key in keys_of(FilterConfig).items()
        if name not in FIRST_KEYS
    }

    assert new == DEFAULTS_OF_NEW_KEYS, "add the new key to DEFAULTS_OF_NEW_KEYS"


@pytest.mark.parametrize(
    "mapping",
    [
        {"threshold_small_box": 10},
        {"threshold_small_box": 10.0},
        {"classes": {"car": {}}},
    ],
)
def test_defaults_that_are_written_out_are_no_other_configuration(mapping):
    config = FilterConfig.from_mapping(mapping)

    assert config == FilterConfig()
    assert config.digest == FilterConfig().digest
    assert config.of_class("car") == ClassConfig()
    assert ClassConfig().min_distance is INHERIT


def test_order_case_and_class_aliases_do_not_change_the_digest():
    classes = {"van": {"accept": ["Truck", "Car"]}, "street_light": {"min_distance": 1}}
    two = {"traffic_light": {"min_distance": 1.0}, "van": {"accept": ["car", "TRUCK"]}}

    first = FilterConfig.from_mapping({"classes": classes})
    second = FilterConfig.from_mapping({"classes": two})

    assert first.digest == second.digest
    assert first.classes["van"].accept == ("Car", "Truck")
    config = FilterConfig.from_mapping(
        {"max_distance": 120.5, "classes": {"van": {"accept": ["Truck", 14]}}}
    )

    again = FilterConfig.from_mapping(json.loads(json.dumps(config.as_dict())))

    assert again == config == pickle.loads(pickle.dumps(config))
    assert {again, config} == {config}


BEYOND_THE_SCHEMA = {
    "found NaN",
    "max_distance (2)",
    "classes.car: min_distance",
    "classes.van.accept: unknown tag 'Trukc'; the nearest valid name is 'Tr",
    "name the same class",
}
"""Faults that the JSON schema does not tell, by words of the error."""


@pytest.mark.parametrize(
    ("raw", "pointer", "words"),
    [
        ({"treshold_small_box": 1}, "/treshold_small_box", "'threshold_small_box'"),
        ({"threshold_small_box": 101}, "/threshold_small_box", "0 to 100 percent"),
        ({"threshold_small_box": -1}, "/threshold_small_box", "found -1"),
        ({"threshold_small_box": True}, "/threshold_small_box", "found true"),
        ({"threshold_small_box": "10"}, "/threshold_small_box", 'found "10"'),
        ({"threshold_small_box": None}, "/threshold_small_box", "found null"),
        ({"size_big_box": float("nan")}, "/size_big_box", "found NaN"),
        ({"min_visible_pixels": 1.5}, "/min_visible_pixels", "a whole number"),
        ({"max_distance": float("inf")}, "/max_distance", "metres or null"),
        ({"max_distance": 10**400}, "/max_distance", "metres or null"),
        ({"profile": "papr"}, "/profile", "did you mean 'paper'"),
        ({"palette": "carla-0.9.15"}, "/palette", "did you mean 'carla-0.9.1"),
        ({"evidence": "dept"}, "/evidence", "did you mean 'depth'"),
        ({"min_distance": 5, "max_distance": 2}, "/min_distance", "max_distance (2)"),
        ({"classes": []}, "/classes", "a mapping of class names"),
        ({"classes": {"car": 3}}, "/classes/car", "classes.car: expected a mapping"),
        ({"classes": {"car": {"threshold": 3}}}, "/classes/car/threshold",
         "classes.car: unknown key 'threshold'; the nearest valid key is"),
        ({"classes": {"car": {"profile": "paper"}}}, "/classes/car/profile",
         "classes.car: unknown key 'profile'"),
        ({"classes": {"a/b": {"size_big_box": 300}}}, "/classes/a~1b/size_big_box",
         "found 300"),
        ({"classes": {"car": {"min_distance": 5}}, "max_distance": 2},
         "/classes/car/min_distance", "classes.car: min_distance"),
        ({"classes": {"van": {"accept": ["Trukc"]}}}, "/classes/van/accept",
         "classes.van.accept: unknown tag 'Trukc'; the nearest valid name is 'Tr"),
        ({"config": {}}, "/config", "unknown key 'config'; expected one of profile, "),
        ({"profile": "x"}, "/profile", 'expected one of paper, carlasimu, found "x"'),
        ({"classes": {"van": {"accept": [30]}}}, "/classes/van/accept", "0 to 29"),
        ({"classes": {"van": {"accept": [True]}}}, "/classes/van/accept", "'True'"),
        ({"classes": {"van": {"accept": []}}}, "/classes/van/accept", "a list of"),
        ({"classes": {"": {}}}, "/classes", "a class name"),
        ({"classes": {"traffic_light": {}, "street_light": {}}},
         "/classes/street_light", "name the same class"),
        ({"a/" + "x" * 100: 1}, "/a~1" + "x" * 78 + "…", "unknown key"),
        ([], "", "found a list of 0"),
    ],
)  # fmt: skip
def test_invalid_value_raises_config_error_with_pointer_and_range(raw, pointer, words):
    with pytest.raises(ConfigError) as caught:
        FilterConfig.from_mapping(raw)

    assert words in caught.value.detail
    assert caught.value.pointer == pointer
    is_valid = Draft202012Validator(schema_of(FilterConfig)).is_valid(raw)
    assert is_valid == (words in BEYOND_THE_SCHEMA)


def test_class_limits_override_or_inherit_the_common_thresholds():
    light = {"threshold_small_box": 2, "min_visible_pixels": 7, "max_distance": None}
    mapping = {"max_distance": 50, "classes": {"street_light": light}}
    config = FilterConfig.from_mapping(mapping)

    limits = config.limits_by_class(["car", "street_light"])

    assert limits.threshold_small_box.tolist() == [10, 2]
    assert limits.min_visible_pixels.tolist() == [10, 7]
    assert limits.threshold_big_box.tolist() == [50, 50]
    assert limits.max_distance.tolist() == [50, np.inf]
    own = ClassLimits(threshold_small_box=2, min_visible_pixels=7)
    assert config.limits_of("street_light") == own
    assert config.as_dict()["classes"] == {"traffic_light": light}
    same = config.limits_by_class(["car", "street_light"])
    others = FilterConfig(min_distance=3).limits_by_class(["car", "street_light"])
    assert {limits, same, others} == {others, limits}
    assert limits != others


def test_decide_config_works_by_itself_and_refuses_other_keys():
    classes = {"van": {"threshold_small_box": 2}}
    part = DecideConfig.from_mapping({"min_visible_pixels": 3, "classes": classes})

    assert part.limits_of("van").threshold_small_box == 2
    assert pickle.loads(pickle.dumps(part)) == part
    assert hash(part) == hash(DecideConfig.from_mapping(part.as_dict()))
    with pytest.raises(ConfigError, match="unknown key 'palette'"):
        DecideConfig.from_mapping({"palette": "auto"})
    all_keys, deciding = FilterConfig.keys(), DecideConfig.keys()

    assert tuple(key for key in all_keys if key in deciding) == deciding
    measuring = "projection min_forward palette encoding channel_order"
    measuring += " lossy_segmentation tags tag_scale depth_encoding"
    assert set(all_keys) - set(deciding) == {*measuring.split()}


def test_diff_configs_lists_every_changed_key():
    before = FilterConfig.from_mapping({"classes": {"van": {"accept": ["Truck"]}}})
    after = FilterConfig.from_mapping(
        {"max_distance": 80, "classes": {"car": {"threshold_small_box": 5}}}
    )

    assert diff_configs(before, after) == [
        ConfigChange("max_distance", None, 80),
        ConfigChange("classes.van.accept", ["Truck"], None),
        ConfigChange("classes.car.threshold_small_box", None, 5),
    ]
    assert diff_configs(after, after) == []


@pytest.mark.parametrize(
    ("evidence", "channels"),
    [
        ("semantic", ()),
        ("depth_center", ("depth_center",)),
        ("auto", ("instance", "depth", "ordered")),
    ],
)
def test_evidence_key_determines_the_channels(evidence, channels):
    assert FilterConfig(evidence=evidence).channels == channels


def non_default_value(default, allowed):
    if isinstance(allowed, NumberRange):
        more = (default or 0) + 4
        return more if more <= allowed.high else default - 4
    if isinstance(allowed, ChangedTagNames | AllowedScale):
        return {"40": "Pedestrian"} if default == {} else 21
    return next(word for word in reversed(allowed.words) if word != default)


OTHER = {
    name: non_default_value(key.default, key.allowed)
    for name, key in keys_of(FilterConfig).items()
}
"""For every key, a valid value other than its default."""


@pytest.mark.parametrize("name", keys_of(FilterConfig))
def test_needs_pixels_is_true_iff_the_key_changes_the_pixel_digest(name):
    before = FilterConfig(evidence="depth")
    after = FilterConfig.from_mapping({**before.as_dict(), name: OTHER[name]})

    needs_pixels = after.measuring().pixel_digest != before.measuring().pixel_digest

    assert keys_of(FilterConfig)[name].needs_pixels == needs_pixels


def random_evidence():
    """Evidence of 500 boxes with random numbers around the defaults of all channels."""
    random = np.random.default_rng(0)
    counts = random.integers(0, 12, (5, 500))
    match, area = random.uniform(0, 60, 500), random.uniform(0, 100, 500)
    columns = ("match_percent", "area_percent", "matched_pixels")
    rows = zip(match.tolist(), area.tolist(), counts[4].tolist(), strict=True)
    evidence = evidence_of([dict(zip(columns, row, strict=True)) for row in rows])
    channels = replace(
        ChannelNumbers.absent(500),
        owned_pixels=counts[0],
        explained_by=random.integers(-1, 1, 500),
        depth_pixels=counts[1],
        center_gap=random.uniform(-5, 5, 500),
        instance_pixels=counts[2],
        lidar_points=counts[3],
    )
    return replace(evidence, channels=channels)


@pytest.mark.parametrize("channel", [SEMANTIC, *CHANNELS])
@pytest.mark.parametrize(
    "name", [name for name, key in keys_of(FilterConfig).items() if key.evidence]
)
def test_evidence_of_a_key_lists_the_channels_that_it_changes(name, channel):
    before = FilterConfig(evidence=channel)
    after = FilterConfig.from_mapping({**before.as_dict(), name: OTHER[name]})

    old, new = (decide(random_evidence(), config).reason for config in (before, after))
    decided = old.tolist() != new.tolist()
    measured = before.measuring().digest != after.measuring().digest

    assert (channel in keys_of(FilterConfig)[name].evidence) == (decided or measured)


EVERY_KEY = {
    **OTHER,
    "classes": {"van": {**dict.fromkeys(NUMBERS, 5), "accept": ["Car", 14]}},
}


@pytest.mark.parametrize(
    "raw",
    [
        {},
        FilterConfig().as_dict(),
        EVERY_KEY,
        {"classes": None},
        {"max_distance": None, "classes": {"van": {"max_distance": None}}},
    ],
)
def test_valid_configuration_passes_the_json_schema(raw):
    FilterConfig.from_mapping(raw)

    assert Draft202012Validator(schema_of(FilterConfig)).is_valid(raw)


def test_schema_has_the_channels_that_use_a_key_and_only_the_keys_of_its_class():
    properties: Any = schema_of(FilterConfig)["properties"]
    of_deciding = schema_of(DecideConfig)
    deciding: Any = of_deciding["properties"]

    assert properties["lidar_min_points"]["x-evidence"] == ["lidar"]
    assert properties["threshold_small_box"]["x-evidence"] == ["semantic"]
    assert properties["ordered_min_pixels"]["x-evidence"] == ["ordered", "auto"]
    assert "x-evidence" not in properties["max_distance"]
    Draft202012Validator.check_schema(of_deciding)
    defaults = {name: setting["default"] for name, setting in deciding.items()}
    assert defaults == DecideConfig().as_dict()


@pytest.mark.parametrize(
    ("keys", "evidence", "pixels"),
    [
        ({}, "auto", 10),
        ({"threshold_small_box": 20}, "auto", 10),
        ({"evidence": "auto"}, "auto", 10),
        ({"evidence": "auto", "min_visible_pixels": 2}, "auto", 2),
        ({"profile": "paper"}, "semantic", 1),
        ({"profile": "paper", "evidence": "auto"}, "auto", 10),
        ({"evidence": "instance"}, "instance", 1),
    ],
)
def test_who_chooses_nothing_gets_the_strongest_evidence(keys, evidence, pixels):
    config = FilterConfig.from_mapping(keys)

    assert (config.evidence, config.min_visible_pixels) == (evidence, pixels)
    assert FilterConfig.from_mapping(config.as_dict()) == config
