"""The rasteriser draws each covered pixel once, from the nearest triangle."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unghost.street.raster import Canvas, draw

WIDTH, HEIGHT = 24, 18


def draw_triangles(triangles):
    canvas = Canvas.blank(WIDTH, HEIGHT)
    draw(canvas, np.array(triangles, float), np.arange(len(triangles)))
    return canvas


def reference_nearness(triangles):
    """The definition, pixel by pixel: three areas' signs say if a centre is inside."""
    nearest = np.zeros((HEIGHT, WIDTH))
    for corners in np.array(triangles, float):
        a, b, c = corners
        whole = area(a, b, c)
        for row in range(HEIGHT):
            for column in range(WIDTH):
                p = np.array([column + 0.5, row + 0.5])
                shares = np.array([area(b, c, p), area(c, a, p), area(a, b, p)]) / whole
                if (shares > 0).all():
                    nearest[row, column] = max(
                        nearest[row, column], shares @ corners[:, 2]
                    )
    return nearest


def area(a, b, c):
    return (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])


# Off the pixel grid, so that no edge goes through a pixel's centre.
corner = st.tuples(
    st.integers(-8, 32).map(lambda n: n + 0.13170),
    st.integers(-8, 26).map(lambda n: n + 0.29314),
    st.integers(1, 50).map(lambda n: n / 10),
)
triangle = st.tuples(corner, corner, corner).filter(lambda t: abs(area(*t)) > 1)


@given(st.lists(triangle, min_size=1, max_size=4))
def test_nearest_triangle_per_pixel_equals_reference(triangles):
    expected, canvas = reference_nearness(triangles), draw_triangles(triangles)

    assert canvas.nearness == pytest.approx(expected, rel=1e-4, abs=1e-6)
    assert np.array_equal(canvas.winner >= 0, expected > 0)


def test_adjacent_triangles_have_no_gap_and_no_overlap():
    a, b, c, d = (2.5, 2.5, 1), (20.5, 2.5, 1), (20.5, 15.5, 1), (2.5, 15.5, 1)

    first, second = (
        draw_triangles([(a, b, c)]).winner == 0,
        draw_triangles([(a, c, d)]).winner == 0,
    )

    assert not (first & second).any()
    assert (first | second).sum() == 18 * 13


def test_triangle_pixels_do_not_depend_on_canvas_size():
    corners = np.array([(-40.0, -30.0, 1.0), (300.0, 10.0, 2.0), (20.0, 260.0, 3.0)])
    large, small = Canvas.blank(200, 150), Canvas.blank(20, 15)

    draw(large, corners[None], np.array([7]))
    draw(small, corners[None] - np.array([60.0, 50.0, 0.0]), np.array([7]))

    assert np.array_equal(large.winner[50:65, 60:80], small.winner)
    assert large.nearness[50:65, 60:80] == pytest.approx(small.nearness, rel=1e-5)


def test_drawing_no_triangles_leaves_canvas_blank():
    canvas = Canvas.blank(4, 3)

    draw(canvas, np.zeros((0, 3, 3)), np.zeros(0, dtype=np.int64))

    assert (canvas.winner == -1).all()
