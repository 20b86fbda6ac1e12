import math

import pytest

from unghost.capture.objects import (
    LocalBox,
    checked_light,
    checked_parked,
    checked_prop,
    checked_vehicle,
    checked_walker,
    is_sane,
)

ORIGIN = (0.0, 0.0, 0.0)
CAR = LocalBox((0.0, 0.0, 0.75), (2.4, 1.0, 0.75))


@pytest.mark.parametrize(
    ("box", "sane"),
    [
        pytest.param(CAR, True, id="a car"),
        pytest.param(LocalBox(ORIGIN, (0.8, 0.0, 0.8)), False, id="no width"),
        pytest.param(LocalBox(ORIGIN, (0.8, 0.05, 0.8)), True, id="just wide enough"),
        pytest.param(LocalBox(ORIGIN, (0.8, 0.3, 250)), False, id="a tower"),
        pytest.param(LocalBox((0, 40, 0), (0.8, 0.3, 0.8)), False, id="elsewhere"),
        pytest.param(LocalBox((0, 0, 9), (0.8, 0.3, 0.8)), True, id="high up"),
        pytest.param(LocalBox(ORIGIN, (-0.8, 0.3, 0.8)), False, id="negative"),
        pytest.param(LocalBox(ORIGIN, (math.nan, 1, 1)), False, id="no number"),
    ],
)
def test_box_with_impossible_size_or_location_is_not_sane(box, sane):
    assert is_sane(box) is sane


@pytest.mark.parametrize("kind", ["bicycle", "motorcycle"])
def test_two_wheeler_without_width_is_repaired_or_omitted(kind):
    flat = LocalBox((0, 40, 0), (0.8, 0.0, 0.8), (0, 30, 0))

    repaired = checked_vehicle(flat, kind, repair=True)

    assert repaired is not None
    assert is_sane(repaired)
    assert repaired.flags == ("default_size",)
    assert repaired.given == ((0, 40, 0), (0.8, 0.0, 0.8))
    assert repaired.rotation == ORIGIN
    assert repaired.location[2] == repaired.extent[2]
    assert checked_vehicle(flat, kind, repair=False) is None
    assert checked_vehicle(flat, "car", repair=True) is None
    assert checked_vehicle(CAR, kind, repair=True) is CAR


def test_only_a_walker_capsule_is_flagged_and_widened_sideways():
    capsule = LocalBox(ORIGIN, (0.188, 0.188, 0.93))

    box = checked_walker(capsule, 0.15)

    assert box is not None
    assert box.flags == ("capsule", "widened")
    assert box.extent == pytest.approx((0.338, 0.338, 0.93))
    unwidened = checked_walker(capsule, 0)
    assert unwidened is not None
    assert (unwidened.flags, unwidened.extent) == (("capsule",), capsule.extent)
    own = LocalBox((0.0, 0.05, 0.0), (0.3, 0.25, 0.9))

    assert checked_walker(own, 0.15) is own
    assert checked_walker(LocalBox(ORIGIN, ORIGIN), 0.15) is None


def test_parked_vehicle_with_mirrored_mesh_is_rotated_180_degrees():
    mirrored = LocalBox((50, 60, 0.75), (-2.4, 1.0, 0.75), (0, 10, 0))

    box = checked_parked(mirrored, "car")

    assert box is not None
    assert box.flags == ("mirrored",)
    assert box.extent == (2.4, 1.0, 0.75)
    assert box.rotation == (0, -170, 0)


@pytest.mark.parametrize(
    ("half", "kind", "kept"),
    [
        ((0.3, 0.3, 0.2), "car", False),
        ((2.4, 1.0, 0.49), "truck", False),
        ((0.8, 0.3, 0.45), "bicycle", True),
        ((2.4, 1.0, 0.75), "car", True),
        ((80, 1.0, 0.75), "car", False),
    ],
)
def test_parked_vehicle_parts_and_too_large_boxes_are_omitted(half, kind, kept):
    assert (checked_parked(LocalBox((50, 60, 0), half), kind) is not None) is kept


def test_prop_rotation_is_reset_and_impossible_size_replaced():
    good = checked_prop(LocalBox((0, 0, 0.7), (2.2, 0.9, 0.7), (0, 40, 0)))
    bad = checked_prop(LocalBox((0, 0, 0.7), (2.2, 0.01, 0.7), (0, 40, 0)))

    assert (good.flags, good.rotation) == (("straightened",), ORIGIN)
    assert good.extent == (2.2, 0.9, 0.7)
    assert bad.flags == ("straightened", "default_size")
    assert is_sane(bad)
    assert bad.given == ((0, 0, 0.7), (2.2, 0.01, 0.7))


@pytest.mark.parametrize(
    ("half", "checked"),
    [
        ((0.2, 0.3, 0.5), ((0.2, 0.3, 0.5), ())),
        ((0.05, 0.3, 0.5), ((0.2, 0.3, 0.5), ("thickened",))),
        ((0.05, 0.02, 0.5), ((0.2, 0.2, 0.5), ("thickened",))),
        ((0.1, 0.1, 0.19), None),
        ((20, 0.2, 0.5), None),
        ((math.inf, 1, 1), None),
    ],
)
def test_thin_light_heads_are_thickened_and_impossible_ones_omitted(half, checked):
    box = checked_light(LocalBox((22, 8, 4.5), half))

    assert (box and (box.extent, box.flags)) == checked
