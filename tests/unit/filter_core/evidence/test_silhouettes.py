"""The pixels that an outline touches or whose centres it holds, for simple shapes."""

import numpy as np
import pytest

from filter_core.evidence.silhouettes import frame_silhouettes, touched_pixels

DIAMOND = [(2, 0), (4, 2), (2, 4), (0, 2)]
RECTANGLE = [(1.5, 0.5), (3.2, 0.5), (3.2, 2), (1.5, 2)]
LINE = [(0.5, 0.5), (3.5, 2.5)]
POINT = [(2.5, 1.5)] * 3


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
def test_touched_pixels_are_all_that_the_outline_touches(points, bounds, expected):
    (mask,) = touched_pixels([np.array(points, float)], np.array([bounds]))

    assert ["".join(".#"[int(pixel)] for pixel in row) for row in mask] == expected


def test_centred_pixels_of_rectangles_are_computed_only_on_request():
    boxes = np.array([[1.6, 0.2, 3.4, 1.0]])
    flat = np.full((1, 8, 3), np.nan)

    (plain,) = frame_silhouettes(boxes, flat, None, (5, 2))
    (centred,) = frame_silhouettes(boxes, flat, None, (5, 2), centres=True)

    assert plain.centred is None
    assert centred.centred is not None
    assert centred.centred.tolist() == [[False, True, False]]
    assert touched_pixels([], np.empty((0, 4), np.int64)) == []
