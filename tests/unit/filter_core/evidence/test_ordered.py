"""The channel `ordered`: which box owns a pixel that several boxes cover."""

import numpy as np
import pytest

from filter_core.evidence.ordered import owned_pixels
from filter_core.evidence.silhouettes import AcceptedPixels, Silhouette


def box(row, x0, x1, mask=None):
    """A box of the pixels x0 to x1 - 1 of a single row; `mask`: the accepted ones."""
    pixels = np.ones((1, x1 - x0), bool) if mask is None else np.array([mask], bool)
    return AcceptedPixels(Silhouette(row, x0, 0, x1, 1), pixels)


def owned(boxes, distance, ids=None, wh=(20, 1)):
    names = ids or [str(row) for row in range(len(distance))]
    counts, explained = owned_pixels(boxes, np.array(distance), names, wh)
    return counts.tolist(), explained.tolist()


def drawing(row, x0, y0, picture, centred=None):
    """A box whose accepted pixels are drawn as # in `picture`."""
    mask = np.array([[pixel == "#" for pixel in line] for line in picture])
    height, width = mask.shape
    own = None if centred is None else np.array(centred, bool)
    outline = Silhouette(row, x0, y0, x0 + width, y0 + height, None, own)
    return AcceptedPixels(outline, mask, mask)


def test_nearest_box_owns_the_shared_pixels_and_explains_the_others():
    assert owned([box(0, 0, 10), box(1, 4, 14)], [30.0, 10.0]) == ([4, 10], [1, -1])
    assert owned([box(0, 2, 6), box(1, 0, 10)], [30.0, 10.0]) == ([0, 10], [1, -1])
    # The one that explains most is named.
    boxes = [box(0, 0, 10), box(1, 0, 3), box(2, 3, 10)]
    assert owned(boxes, [50.0, 10.0, 20.0]) == ([0, 3, 7], [2, -1, -1])
    # A ghost without pixels explains nothing, nor does a box of unknown distance.
    unseen = box(0, 0, 10, mask=[False] * 10)
    assert owned([unseen, box(1, 0, 10)], [5.0, 20.0]) == ([0, 10], [-1, -1])
    assert owned([box(0, 0, 10), box(1, 0, 10)], [np.nan, 20.0]) == ([-1, 10], [-1, -1])


CAR_WITH_A_VIEW_OVER_ITS_BONNET = [
    "..........",
    "..####....",
    "..####.##.",
    "..####.##.",
    "..####....",
    "..#######.",
    "..#######.",
    "..........",
]


BONNET = CAR_WITH_A_VIEW_OVER_ITS_BONNET[1:4]
LARGE = ["." * 16] + [row[6:10] + "." * 12 for row in BONNET] + ["." * 16] * 9


@pytest.mark.parametrize(
    ("behind", "expected"),
    [
        (drawing(1, 6, 1, [row[6:10] for row in BONNET]), ([34, 4], [-1, -1])),
        # It does not contain the patch.
        (drawing(1, 8, 1, [row[8:10] for row in BONNET]), ([34, 0], [-1, 0])),
        # It is much larger than the patch.
        (drawing(1, 6, 0, LARGE), ([34, 0], [-1, 0])),
    ],
)
def test_pixels_above_a_bonnet_belong_to_the_box_behind(behind, expected):
    near = drawing(0, 0, 0, CAR_WITH_A_VIEW_OVER_ITS_BONNET)

    assert owned([near, behind], [10.0, 40.0], wh=(30, 20)) == expected


def test_both_halves_of_a_car_behind_a_tree_belong_to_it():
    halves = [".........", ".###.###.", ".###.###.", "........."]
    near = drawing(0, 0, 0, halves)
    ghost = drawing(1, 4, 0, [line[4:9] for line in halves])

    assert owned([near, ghost], [10.0, 40.0], wh=(12, 8)) == ([12, 0], [-1, 0])


def test_pixel_with_centre_outside_the_nearer_outline_is_not_taken():
    near = drawing(0, 0, 0, ["####"], centred=[[True, True, True, False]])
    far = drawing(1, 2, 0, ["##"])

    assert owned([near, far], [10.0, 40.0]) == ([4, 1], [-1, 0])
    # A box without the centre of a pixel owns the pixels that it touches.
    thin = drawing(0, 0, 0, ["##"], centred=[[False, False]])
    assert owned([thin, drawing(1, 0, 0, ["##"])], [10.0, 40.0]) == ([2, 0], [-1, 0])
