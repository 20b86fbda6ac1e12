"""Which keys change the measured numbers, and which measurements can be reused.

The digests themselves are pinned in tests/pins.
"""

import json
import pickle

import pytest

from filter_core.config.filter import FilterConfig
from filter_core.segmentation.reading import SegmentationOptions

ACCEPTING = {"classes": {"van": {"accept": ["Truck"]}}}


def measuring(**keys):
    """What the paper's filter measures, unless other evidence is named."""
    return FilterConfig.from_mapping({"profile": "paper", **keys}).measuring()


def stored(config):
    """A configuration as the database stores it with a measurement."""
    plain = {**config.as_dict(), "sources": dict(config.reading.sources)}
    return json.loads(json.dumps(plain))


@pytest.mark.parametrize(
    "keys",
    [
        {"threshold_small_box": 3},
        {"max_distance": 9, "min_visible_pixels": 7},
        {"depth_tolerance": 2},  # this configuration does not measure depth
        {"depth_encoding": "carla-bgr"},
        {"classes": {"van": {"threshold_big_box": 5}}},
    ],
)
def test_thresholds_do_not_change_the_measurement_digest(keys):
    assert measuring(**keys).digest == measuring().digest


@pytest.mark.parametrize(
    "keys",
    [
        {"palette": "carla-0.9.0"},
        {"tags": {40: "Pedestrian"}},
        {"tag_scale": 21},
        {"projection": "naive"},
        {"min_forward": 1},
        {"evidence": "ordered"},
        {"profile": "carlasimu"},
    ],
)
def test_keys_that_need_pixels_change_the_pixel_digest(keys):
    assert measuring(**keys).pixel_digest != measuring().pixel_digest


def test_accept_sets_change_the_pixels_only_in_carlasimu_which_has_no_channels():
    plain, other = measuring(), measuring(**ACCEPTING)
    assert plain.digest != other.digest
    assert plain.pixel_digest == other.pixel_digest

    published = measuring(profile="carlasimu")
    assert (
        measuring(profile="carlasimu", **ACCEPTING).pixel_digest
        != published.pixel_digest
    )
    for keys in ({}, ACCEPTING):
        config = measuring(profile="carlasimu", **keys)
        assert config.is_covered_by(stored(config.with_channels(["ordered"])))


def test_measurement_covers_fewer_channels_with_the_same_tolerance():
    config = measuring(evidence="depth").with_channels(["lidar", "depth", "ordered"])
    assert config.channels == ("ordered", "depth", "lidar")
    assert config.files == ("depth", "lidar")
    much = stored(measuring(evidence="auto").with_channels(["lidar"]))

    assert measuring().is_covered_by(much)
    assert measuring(evidence="depth").is_covered_by(much)
    assert not measuring(evidence="depth", depth_tolerance=1).is_covered_by(much)
    assert measuring(evidence="ordered", depth_tolerance=1).is_covered_by(much)
    assert not measuring(evidence="depth_center").is_covered_by(much)
    assert not measuring(palette="carla-0.9.0").is_covered_by(much)


def test_depth_encoding_counts_only_where_a_depth_image_is_read():
    named = {"depth_encoding": "carla-bgr"}
    plain, swapped = measuring(evidence="depth"), measuring(evidence="depth", **named)

    assert "depth_encoding" not in json.dumps(plain.as_dict())
    assert swapped.digest != plain.digest
    assert not swapped.is_covered_by(stored(plain))
    assert not plain.is_covered_by(stored(swapped))
    assert measuring(evidence="ordered", **named).is_covered_by(
        stored(plain.with_channels(["ordered"]))
    )
    assert FilterConfig().measuring().as_measured(stored(swapped)) == swapped


def test_stored_measurement_restores_its_configuration():
    reading = SegmentationOptions.agreed(
        {"the dataset": SegmentationOptions(palette="carla-0.9.10")}
    )
    config = FilterConfig(evidence="depth", depth_tolerance=0.5)
    measured = config.measuring(reading, ignored={"polygons": []})

    again = FilterConfig().measuring().as_measured(stored(measured))

    assert again.digest == measured.digest
    assert again.reading == reading
    assert pickle.loads(pickle.dumps(measured)) == measured


def test_measurement_of_a_changed_carla_covers_no_other():
    named = measuring(tags={"40": "Pedestrian"}, tag_scale=21)

    assert FilterConfig().measuring().as_measured(stored(named)).reading == (
        named.reading
    )
    assert named.is_covered_by(stored(named))
    assert not named.is_covered_by(stored(measuring()))
    assert not measuring().is_covered_by(stored(named))
    assert measuring(tags={}, tag_scale=1).digest == measuring().digest


@pytest.mark.parametrize("extra", [(), ("lidar",), ("ordered", "instance")])
@pytest.mark.parametrize("evidence", ["auto", "depth", "depth_center", "instance"])
def test_equal_measurement_digests_have_equal_requirements(evidence, extra):
    """Configurations with different evidence can share one measurement's digest."""
    config = measuring(evidence=evidence).with_channels(extra)
    other = FilterConfig().measuring().as_measured(stored(config))

    assert other.digest == config.digest
    for kind in ("depth", "instances"):
        assert other.requires(kind) == config.requires(kind)
