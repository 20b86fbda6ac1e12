"""The pixels that an outline touches or whose centres it holds, for simple shapes."""

from __future__ import annotations

import numpy as np
import pytest

from filter_core.evidence.silhouettes import (
    centred_pixels,
    frame_silhouettes,
    touched_pixels,
)

DIAMOND = [(2, 0), (4, 2), (2, 4), (0, 2)]
RECTANGLE = [(1.5, 0.5), (3.2, 0.5), (3.2, 2), (1.5, 2)]
LINE = [(0.5, 0.5), (3.5, 2.5)]
POINT = [(2.5, 1.5)] * 3


def drawn(points, bounds, pixels=touched_pixels):
    (mask,) = pixels([np.array(points, float)], np.array([bounds]))
    return ["".join(".#"[int(pixel)] for pixel in row) for row in mask]


@pytest.mark.parametrize(
    ("points", "bounds", "expected"),
    [
        (DIAMOND, (0, 0, 5, 4), [".##..", "####.", "####.", ".##.."]),
        (DIAMOND, (2, 1, 5, 3), ["##.", "##."]),
        (RECTANGLE, (0, 0, 5, 2), [".###.", ".###."]),
        (LINE, (0, 0, 4, 3), ["##..", ".##.", "..##"]),
        (POINT, (1, 0, 4, 3), ["...", ".#.", "..."]),
    ],
    ids=["diamond", "part of it", "rectangle", "line", "point"],
)
def test_every_pixel_that_an_outline_touches_belongs_to_it(points, bounds, expected):
    assert drawn(points, bounds) == expected


@pytest.mark.parametrize(
    ("points", "bounds", "expected"),
    [
        (DIAMOND, (0, 0, 5, 4), [".##..", "####.", "####.", ".##.."]),
        (RECTANGLE, (0, 0, 5, 2), [".##..", ".##.."]),
        (LINE, (0, 0, 4, 3), ["#...", "....", "...#"]),
        ([(1.6, 0.2), (1.9, 2.8)], (0, 0, 3, 3), ["...", "...", "..."]),
    ],
    ids=["diamond", "rectangle", "line", "between the centres"],
)
def test_pixels_whose_centres_lie_within_an_outline_can_show_it(
    points, bounds, expected
):
    assert drawn(points, bounds, centred_pixels) == expected


def test_centres_are_looked_at_in_rectangles_too_but_only_if_asked():
    boxes = np.array([[1.6, 0.2, 3.4, 1.0]])
    flat = np.full((1, 8, 3), np.nan)

    (plain,) = frame_silhouettes(boxes, flat, None, (5, 2))
    (asked,) = frame_silhouettes(boxes, flat, None, (5, 2), centres=True)

    assert plain.centred is None
    assert asked.centred is not None
    assert asked.centred.tolist() == [[False, True, False]]


def test_nothing_is_drawn_of_nothing():
    assert touched_pixels([], np.empty((0, 4), np.int64)) == []
