"""The truncation in KITTI labels equals the share of a box outside the image."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from filter_core.geometry.boxes import correct_xyxy
from tests.support.exporting import box, export, frame

WH = (100, 80)

CORNERS = st.one_of(st.sampled_from([0.0, -0.0, 80.0, 100.0]), st.floats(-30, 130))


@st.composite
def rectangles(draw):
    """Rectangles, some of which lie partly or wholly outside the image, or touch it."""
    x, y = (
        sorted([draw(CORNERS), draw(CORNERS)]),
        sorted([draw(CORNERS), draw(CORNERS)]),
    )
    return [x[0], y[0], x[1], y[1]]


def share_outside_image(xyxy):
    """The share of a rectangle that lies outside the image, from 0 to 1."""
    whole = (xyxy[2] - xyxy[0]) * (xyxy[3] - xyxy[1])
    width = min(xyxy[2], WH[0]) - max(xyxy[0], 0)
    height = min(xyxy[3], WH[1]) - max(xyxy[1], 0)
    return 1 - max(width, 0) * max(height, 0) / whole


@given(rows=st.lists(rectangles(), max_size=6))
def test_kitti_truncation_is_the_share_of_the_given_box_outside_the_image(rows):
    corrected, _ = correct_xyxy(np.array(rows, float).reshape(-1, 4), WH)
    visible = [
        (index, xyxy)
        for index, xyxy in enumerate(corrected.tolist())
        if min(xyxy[2] - xyxy[0], xyxy[3] - xyxy[1]) >= 0.01
    ]
    boxes = [box(at, xyxy, given={"xyxy": rows[at]}) for at, xyxy in visible]

    files = export("kitti", [frame("a", *boxes, wh=WH)], split=1.0, images="none")

    lines = files["training/label_2/000000.txt"].decode().splitlines()
    told = [float(line.split()[1]) for line in lines]
    expected = [share_outside_image(rows[at]) for at, _ in visible]
    np.testing.assert_allclose(told, expected, atol=1e-4)
