"""Recognising the palette family and the channel order from an image's colours."""

import pytest

from filter_core.errors import SegmentationError
from filter_core.segmentation.codes import CODE_OF, packed
from filter_core.segmentation.palettes import palette_of
from filter_core.segmentation.recognition import NamedReading, recognise

STREET = ("Road", "Building", "Vegetation")
"""Names that every family has, in the same colours."""
FENCE_BEFORE_0_9_14 = (100, 40, 40)
TERRAIN_BEFORE_0_9_14 = (145, 170, 100)
TERRAIN = (152, 251, 152)
TRUCK, BUS, RIDER = (0, 0, 70), (0, 60, 100), (255, 0, 0)
CAR_OR_VEHICLE = (0, 0, 142)
ROCK = (180, 130, 70)
SKY = ROCK[::-1]


def street(*colors, order="rgb"):
    """The codes of the colours of a street, and of `colors`."""
    palette = palette_of("carla-0.9.14")
    rgb = [palette.tags[palette.tag_of(name)].rgb for name in STREET]
    return [CODE_OF[packed(color, order)] for color in (*rgb, *colors)]


@pytest.mark.parametrize(
    ("color", "family"),
    [
        (TERRAIN, "carla-0.9.14"),
        (TRUCK, "carla-0.9.14"),
        (RIDER, "carla-0.9.14"),
        (FENCE_BEFORE_0_9_14, "carla-0.9.10"),
        (TERRAIN_BEFORE_0_9_14, "carla-0.9.10"),
        ((250, 170, 160), "carla-0.9.0"),
    ],
)
def test_colour_unique_to_one_family_determines_the_family(color, family):
    assert recognise(street(color), NamedReading()).family == family


def test_families_are_rivals_only_if_they_name_a_colour_differently():
    reading = recognise(street(), NamedReading())

    assert (reading.family, reading.rivals) == ("carla-0.9.14", ())
    assert reading.notes == (
        "read as carla-0.9.14; carla-0.9.10 and carla-0.9.0 would mean the same by "
        "the colours that occur",
    )
    reading = recognise(street(SKY, CAR_OR_VEHICLE), NamedReading())

    assert (reading.family, reading.rivals) == ("carla-0.9.14", ("carla-0.9.10",))
    assert reading.notes == (
        "read as carla-0.9.14; carla-0.9.10 has the same colours, but calls "
        "(0, 0, 142) Vehicle instead of Car",
    )


def test_paper_table1_is_recognised_only_by_a_mixture_of_colours():
    by_truck = recognise(street(TRUCK), NamedReading())
    by_both = recognise(street(TRUCK, FENCE_BEFORE_0_9_14), NamedReading())

    assert (by_truck.family, by_both.family) == ("carla-0.9.14", "paper-table1")


def test_colours_of_two_families_at_once_are_ambiguous():
    with pytest.raises(SegmentationError) as caught:
        recognise(street(TERRAIN, TERRAIN_BEFORE_0_9_14), NamedReading())

    assert caught.value.kind == "ambiguous_palette"
    assert str(caught.value) == (
        "the colours that occur belong to carla-0.9.14 and carla-0.9.10 at once: only "
        "carla-0.9.14 has (152, 251, 152), only carla-0.9.10 has (145, 170, 100); "
        "name the palette"
    )


def test_more_colours_of_one_family_outweigh_a_stray_one_of_another():
    reading = recognise(street(TERRAIN, TRUCK, TERRAIN_BEFORE_0_9_14), NamedReading())

    assert reading.family == "carla-0.9.14"
    assert reading.missing == {CODE_OF[packed(TERRAIN_BEFORE_0_9_14)]}


@pytest.mark.parametrize(
    ("family", "other"),
    [
        ("carla-0.9.10", TERRAIN_BEFORE_0_9_14),  # the colours are ambiguous
        ("paper-table1", TRUCK),  # it may be named for images of other families
    ],
)
def test_named_family_is_used_and_lacks_a_colour_of_another(family, other):
    reading = recognise(street(TERRAIN, other), NamedReading(family=family))

    assert reading.family == family
    assert reading.missing == {CODE_OF[packed(TERRAIN)]}


CONTRADICTIONS = {
    "another family": (
        NamedReading(family="carla-0.9.10", sources={"palette": "the dataset"}),
        street(TERRAIN),
        r"the dataset says palette carla-0\.9\.10, the colours that occur prove "
        r"carla-0\.9\.14: \(152, 251, 152\) is Terrain there and no colour of",
    ),
    "another channel order": (
        NamedReading(order="rgb", sources={"channel_order": "the config"}),
        street(TRUCK, order="bgr"),
        "the config says channel_order rgb, the colours that occur prove bgr: ",
    ),
    "another channel order, by nobody in particular": (
        NamedReading(order="bgr"),
        street(TRUCK),
        "the caller says channel_order bgr, the colours that occur prove rgb: ",
    ),
}


@pytest.mark.parametrize(
    ("named", "codes", "message"), CONTRADICTIONS.values(), ids=CONTRADICTIONS
)
def test_named_family_or_order_that_contradicts_colours_is_refused(
    named, codes, message
):
    with pytest.raises(SegmentationError, match=message) as caught:
        recognise(codes, named)

    assert caught.value.kind == "segmentation_contradiction"


def test_channel_order_is_told_by_sky_and_rock_or_is_rgb_with_a_note():
    swapped = recognise(street(SKY, CAR_OR_VEHICLE, order="bgr"), NamedReading())
    rock = recognise(street(SKY, ROCK, CAR_OR_VEHICLE), NamedReading())

    assert swapped.order == "bgr"
    assert swapped.notes[-1] == "red and blue are swapped in the file; read as bgr"
    assert (rock.family, rock.order) == ("carla-0.9.14", "rgb")
    greys = [(0, 0, 0), (70, 70, 70), SKY]

    reading = recognise([CODE_OF[packed(color)] for color in greys], NamedReading())

    assert reading.order == "rgb"
    assert reading.notes[-1] == (
        "the colours that occur do not tell the channel order; read as rgb"
    )
