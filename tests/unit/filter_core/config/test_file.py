"""Loading configuration files: our keys, the paper's published file, invalid files."""

import pytest

from filter_core.config.file import load_config
from filter_core.config.filter import FilterConfig
from filter_core.errors import ConfigError

# The keys of carlasimu's boundingBox.yaml, with other values and other comments.
CARLASIMU = r"""
sitting:
  cam_rgb:
    save_to_file: True
    save_dir: 'out\cam'
    3D: False
    filter: True
    max_distance: 50   # metres
    min_distance: 1
    actors:
      vehicles: True
      walkers: True
    num_image: 1000
  lidar_sensor:
    save_to_file: False
  fiter_boundinbox: True
  threshold_small_box: 12
  size_big_box: 65
  threshold_big_box: 45
  time_screen_shot: 1
"""


@pytest.mark.parametrize(
    "text", ["", "# nothing\n", "classes:\n", "{}", b"\xef\xbb\xbf"]
)
def test_empty_file_gives_the_default_configuration(text):
    assert load_config(text).config == FilterConfig()


def test_filter_config_keys_load_from_yaml_and_json():
    yaml = "threshold_small_box: 5\nclasses:\n  van: {accept: [Truck, Car]}\n"
    classes = '{"van": {"accept": ["Car", "Truck"]}}'
    json = f'\n{{\n\t"classes": {classes}, "threshold_small_box": 0.5e1}}'

    assert load_config(yaml).config == load_config(json.encode()).config
    assert load_config(yaml).unused_keys == ()


def test_carlasimu_config_file_loads_and_lists_unused_keys():
    loaded = load_config(CARLASIMU)

    assert loaded.config == FilterConfig(
        profile="carlasimu",
        threshold_small_box=12,
        size_big_box=65,
        threshold_big_box=45,
        projection="naive",
        min_forward=1,
    )
    assert loaded.unused_keys == (
        "sitting.cam_rgb.save_to_file",
        "sitting.cam_rgb.save_dir",
        "sitting.cam_rgb.3D",
        "sitting.cam_rgb.max_distance",
        "sitting.cam_rgb.actors.vehicles",
        "sitting.cam_rgb.actors.walkers",
        "sitting.cam_rgb.num_image",
        "sitting.lidar_sensor.save_to_file",
        "sitting.fiter_boundinbox",
        "sitting.time_screen_shot",
    )
    config = load_config("sitting: {cam_rgb: {filter: False}}").config

    for name in ("car", "walker", "street_light"):
        assert config.limits_by_class((name,)).passed.all()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("sitting: {}", "no key"),
        ("sitting: {host: a, port: 2000}", "sitting.host, sitting.port"),
        ("sitting: {cam_rgb: {fov: 90}}", "sitting.cam_rgb.fov"),
        (
            "sitting: {building: 1, b: 2, c: 3, d: 4, e: 5, f: 6}",
            "sitting.building, sitting.b, sitting.c, sitting.d, sitting.e and others",
        ),
    ],
)
def test_another_file_of_carlasimu_is_refused(text, words):
    with pytest.raises(ConfigError) as caught:
        load_config(text)

    assert caught.value.pointer == "/sitting"
    assert caught.value.detail == (
        "expected a key of carlasimu's boundingBox.yaml that the filter uses "
        "(sitting.threshold_small_box, sitting.size_big_box, "
        "sitting.threshold_big_box, sitting.cam_rgb.min_distance or "
        f"sitting.cam_rgb.filter), found {words}"
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("profile: paper\nprofile: paper", "line 2, column 1: the key 'profile' is"),
        ("classes: {car: {}, car: {}}", "the key 'car' is given twice"),
        ('{"profile": "paper", "profile": "paper"}', "'profile' is given twice"),
        ("{'a': " * 5000, "nested too deeply"),
        ('{"a": ' * 6000, "nested too deeply"),
        ("a: &x [1]\nb: *x", "line 2, column 4: aliases are not allowed"),
        ("<<: {profile: paper}", "a key must be plain"),
        ("? [a]\n: b", "a key must be plain"),
        ("a: !!python/object/apply:os.system [ls]", "could not determine"),
        ("[" * 5000, "nested too deeply"),
        ("{", "line 1, column 2"),
        ("a: \x00", "not readable as YAML"),
        (b"\xff\xfea", "expected YAML in UTF-8"),
        ("a: 2024-13-45", "a value cannot be read"),
        ("a: " + "9" * 9000, "a number has too many digits"),
        ("profile: " + "1:" * 4000 + "1", "a number has too many digits"),
        ("profile: 0x" + "f" * 9000, "a number has too many digits"),
        ("a: " + "1:" * 400 + "1.5", "a value cannot be read"),
        ("a: [" + "b," * 20_000 + "]", "more than 10000 values"),
        ('a: "\\ud800"', "column 4: half of a surrogate pair is not text"),
        ('"\\udc00": 1', "column 1: half of a surrogate pair is not text"),
        ('{"\\ud800": 1}', "column 2: half of a surrogate pair is not text"),
        ("a" * 1001 + ": 1", "a key has more than 1000 characters"),
        ("a: " + "x" * 70_000, "at most 65536 characters"),
        ("[1, 2]", "expected a mapping of keys, found a list of 2"),
        ("1: 2", "unknown key 1"),
        ("sitting: 3", "expected one root key 'sitting'"),
        ("sitting: {}\nprofile: paper", "found 'sitting', 'profile'"),
        ("--- {}\n--- {}", "another document"),
        ("sitting: {cam_rgb: {filter: 3}}", "expected true or false, found 3"),
        (
            "sitting: {threshold_small_box: 120}",
            "threshold_small_box: expected a number",
        ),
    ],
)
def test_invalid_configuration_file_is_refused(text, words):
    with pytest.raises(ConfigError) as caught:
        load_config(text)

    assert words in caught.value.detail


def test_unused_keys_are_truncated_and_limited_to_100():
    leaves = ", ".join(f"k{number}: 1" for number in range(2000))
    text = f"sitting: {{size_big_box: 1, {'x' * 900}: {{{leaves}}}}}"

    unused = load_config(text).unused_keys

    assert unused == tuple(f"sitting.{'x' * 80}.k{number}" for number in range(100))


@pytest.mark.parametrize(
    ("text", "evidence", "min_visible_pixels"),
    [
        ("threshold_small_box: 20", "depth", 1),
        ("", "depth", 1),
        ("evidence: auto", "auto", 10),
        ("profile: paper", "semantic", 1),
        ("sitting: {threshold_small_box: 5}", "semantic", 1),
    ],
)
def test_file_that_names_no_evidence_leaves_that_of_a_dataset(
    text, evidence, min_visible_pixels
):
    active = FilterConfig(evidence="depth", threshold_small_box=3)

    config = load_config(text).after(active)

    assert (config.evidence, config.min_visible_pixels) == (
        evidence,
        min_visible_pixels,
    )
    assert config.threshold_small_box == load_config(text).config.threshold_small_box
