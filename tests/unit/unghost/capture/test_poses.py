import pytest

from filter_core.geometry.pose import Transform
from unghost.capture.annotating import differs
from unghost.capture.simulator import has_wrong_metadata, version_numbers


@pytest.mark.parametrize(
    ("version", "numbers", "wrong"),
    [
        ("0.9.13", (0, 9, 13), False),
        ("0.9.14", (0, 9, 14), True),
        ("0.9.15-dirty", (0, 9, 15), True),
        ("v0.9.15-12-gabc1234", (0, 9, 15), True),
        ("0.9.16", (0, 9, 16), False),
        ("unknown", (), False),
    ],
)
def test_carla_versions_with_wrong_metadata_are_recognised(version, numbers, wrong):
    assert version_numbers(version) == numbers
    assert has_wrong_metadata(version) is wrong


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (Transform((0.009, 0, 0)), False),
        (Transform((0.011, 0, 0)), True),
        (Transform((0, 0, 0), (0, 0.09, 0)), False),
        (Transform((0, 0, 0), (0, 0.11, 0)), True),
        (Transform((0, 0, 0), (0, 359.95, 0)), False),
        (Transform((0, 0, 0), (0, -360, 0)), False),
    ],
)
def test_poses_differ_above_a_centimetre_or_a_tenth_of_a_degree(other, expected):
    assert differs(Transform(), other) is expected
