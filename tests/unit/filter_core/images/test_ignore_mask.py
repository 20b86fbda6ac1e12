"""Ignore masks, from an image or from polygons: pixels that never count."""

import numpy as np
import pytest

from filter_core.errors import ImageError, ImageSizeMismatch
from filter_core.images.ignore_mask import IgnoreMaskError, read_ignore_mask
from tests.support.pictures import png, with_alpha

BOTTOM = np.array([[0, 0, 0, 0], [0, 0, 0, 0], [0, 9, 9, 0]], np.uint8)


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(png(BOTTOM), id="grey"),
        pytest.param(png(np.dstack([BOTTOM, BOTTOM * 0, BOTTOM])), id="RGB"),
        pytest.param(png(with_alpha(np.dstack([BOTTOM] * 3))), id="RGBA"),
        pytest.param(png((BOTTOM > 0).astype(np.uint16) * 300), id="16 bits"),
    ],
)
def test_non_black_pixels_of_a_mask_are_ignored(content):
    mask = read_ignore_mask(content, (4, 3))

    np.testing.assert_array_equal(mask, BOTTOM > 0)


POLYGONS = {
    "square": ([[1, 1], [3, 1], [3, 3], [1, 3]], "....,.##.,.##."),
    "other way": ([[1, 3], [3, 3], [3, 1], [1, 1]], "....,.##.,.##."),
    "triangle": ([[0, 0], [4, 0], [0, 4]], "###.,##..,#..."),
    "all": ([[-9, -9], [9, -9], [9, 9], [-9, 9]], "####,####,####"),
    "outside": ([[5, 5], [9, 5], [9, 9]], "....,....,...."),
    "thin": ([[1.6, 0], [2.4, 0], [2.4, 3], [1.6, 3]], "....,....,...."),
}


@pytest.mark.parametrize(("polygon", "expected"), POLYGONS.values(), ids=POLYGONS)
def test_a_pixel_is_ignored_if_its_centre_is_inside_a_polygon(polygon, expected):
    mask = read_ignore_mask([polygon], (4, 3))

    drawn = ",".join("".join("#" if pixel else "." for pixel in row) for row in mask)
    assert drawn == expected


def test_polygons_that_share_an_edge_share_no_pixel_and_are_joined():
    left: list[list[float]] = [[0, 0], [2.5, 0], [1.5, 3], [0, 3]]
    right: list[list[float]] = [[2.5, 0], [4, 0], [4, 3], [1.5, 3]]
    corner: list[list[float]] = [[0, 0], [1, 0], [1, 1], [0, 1]]

    sides = [read_ignore_mask([polygon], (4, 3)) for polygon in (left, right)]

    assert (sides[0] ^ sides[1]).all()
    np.testing.assert_array_equal(read_ignore_mask([corner, left], (4, 3)), sides[0])


@pytest.mark.parametrize(
    ("polygons", "message"),
    [
        ([[[0, 0], [1, 1]]], "polygon 0: expected at least three corners"),
        ([[[0, 0, 0]] * 3], "polygon 0: expected at least three corners"),
        ([[[0, 0], [1, "x"], [2, 2]]], "polygon 0: expected at least three corners"),
        ([[[0, 0], [1], [2, 2]]], "polygon 0: expected at least three corners"),
        ([[[0, 0], [float("nan"), 1], [2, 2]]], "polygon 0: expected finite corners"),
    ],
)
def test_invalid_polygon_is_refused_with_its_pointer(polygons, message):
    with pytest.raises(IgnoreMaskError, match=message) as caught:
        read_ignore_mask(polygons, (4, 3))

    assert caught.value.pointer == "/ignore_mask/0"


def test_damaged_mask_or_one_of_another_size_is_refused():
    content = png(np.tile(BOTTOM, (20, 20)))
    damaged = content[:50] + bytes(10) + content[60:]

    with pytest.raises(ImageError):
        read_ignore_mask(damaged, (80, 60))
    with pytest.raises(ImageSizeMismatch, match="the ignore mask is 4 x 3 pixels"):
        read_ignore_mask(png(BOTTOM), (3, 4))
