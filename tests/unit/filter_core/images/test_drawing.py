"""Boxes are drawn with a line style and a colour for each verdict."""

import numpy as np

from filter_core.images.drawing import COLORS, DrawnBox, draw_boxes


def drawn(verdict, xyxy=(10.0, 10.0, 90.0, 50.0), edges=None, *, solid=False):
    canvas = np.full((60, 100, 3), 200, np.uint8)
    draw_boxes(canvas, [DrawnBox(verdict, xyxy, edges)], edges=solid)
    return canvas


def gaps(canvas):
    """The number of gaps in the upper edge of the drawn box."""
    row = canvas[10, 14:86].astype(int)
    lit = np.abs(row - 20).max(axis=1) > 60
    return int((lit[:-1] & ~lit[1:]).sum())


def test_each_verdict_has_its_stroke_and_colour_inside_of_the_image():
    gaps_of = {verdict: gaps(drawn(verdict)) for verdict in COLORS}

    assert gaps_of["kept"] == 0
    assert 0 < gaps_of["rejected"] < gaps_of["unmeasured"]
    for verdict, color in COLORS.items():
        distance = np.abs(drawn(verdict).astype(int) - np.array(color)).sum(axis=2)
        assert distance.min() <= 6
    assert (drawn("rejected", None) == 200).all()
    assert drawn("rejected", (-500.0, -500.0, 700.0, 700.0)).shape == (60, 100, 3)


def test_3d_edges_are_drawn_only_if_requested_and_present():
    line = [[20.0, 30.0, 80.0, 30.0]]

    solid = drawn("kept", edges=line, solid=True)
    not_asked = drawn("kept", edges=line)
    none = drawn("kept", edges=None, solid=True)

    assert (solid[10, 50] == 200).all()
    assert (solid[30, 50] != 200).any()
    np.testing.assert_array_equal(not_asked, none)
