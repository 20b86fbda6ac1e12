"""Order of distance: who owns a pixel."""

from __future__ import annotations

import numpy as np

from filter_core.channels.accepted import AcceptedPixels
from filter_core.channels.ordered import owned_pixels
from filter_core.channels.silhouettes import Silhouette


def box(row, x0, x1, mask=None):
    """The pixels x0 .. x1 - 1 of an image of one row."""
    pixels = np.ones((1, x1 - x0), bool) if mask is None else np.array([mask], bool)
    return AcceptedPixels(Silhouette(row, x0, 0, x1, 1), pixels)


def owned(boxes, distance, ids=None):
    names = ids or [str(row) for row in range(len(distance))]
    counts, explained = owned_pixels(boxes, np.array(distance), names, (20, 1))
    return counts.tolist(), explained.tolist()


def test_the_nearer_box_takes_what_both_could_have():
    assert owned([box(0, 0, 10), box(1, 4, 14)], [30.0, 10.0]) == ([4, 10], [1, -1])


def test_a_box_wholly_explained_owns_nothing_and_names_who_explains_it():
    assert owned([box(0, 2, 6), box(1, 0, 10)], [30.0, 10.0]) == ([0, 10], [1, -1])


def test_a_ghost_in_front_takes_nothing_from_what_is_seen_through_it():
    unseen = box(0, 0, 10, mask=[False] * 10)

    assert owned([unseen, box(1, 0, 10)], [5.0, 20.0]) == ([0, 10], [-1, -1])


def test_an_unknown_distance_neither_explains_nor_is_tested():
    assert owned([box(0, 0, 10), box(1, 0, 10)], [np.nan, 20.0]) == ([-1, 10], [-1, -1])


def test_equal_distances_go_by_id():
    assert owned([box(0, 0, 4), box(1, 0, 4)], [9.0, 9.0], ["b", "a"]) == (
        [0, 4],
        [1, -1],
    )


def test_the_box_that_explains_most_is_named():
    boxes = [box(0, 0, 10), box(1, 0, 3), box(2, 3, 10)]

    assert owned(boxes, [50.0, 10.0, 20.0])[1] == [2, -1, -1]
