"""The evidence channels equal slow definitions on random scenes."""

from itertools import permutations
from typing import Any

import cv2
import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from filter_core.evidence.depth import depth_interval
from filter_core.evidence.instances import assign_instances
from filter_core.evidence.lidar import points_inside
from filter_core.evidence.ordered import islands, owned_pixels, silhouette_bounds
from filter_core.evidence.silhouettes import (
    AcceptedPixels,
    Silhouette,
    centred_pixels,
    touched_pixels,
)
from filter_core.geometry.camera import Camera
from filter_core.geometry.pose import Transform, transform_matrices
from tests.support.sensors import box_ahead

WH = (12, 8)
weights = hnp.arrays(
    np.float64,
    st.tuples(st.integers(1, 4), st.integers(1, 4)),
    elements=st.sampled_from([0.0, 1.0, 2.0, 3.5, 7.0]),
)


def total_weight(weight, chosen):
    return sum(weight[row, column] for row, column in enumerate(chosen) if column >= 0)


@given(weights)
def test_assign_instances_has_the_largest_total_weight(weight):
    rows, columns = weight.shape
    chosen = assign_instances(weight, np.full(rows, -1))

    padded = np.pad(weight, ((0, 0), (0, rows)))
    best = max(
        total_weight(padded, order)
        for order in permutations(range(columns + rows), rows)
    )
    used = chosen[chosen >= 0].tolist()
    assert len(used) == len(set(used))
    assert np.isclose(total_weight(weight, chosen), best)


@st.composite
def frames_with_distances(draw):
    """Boxes with random accepted pixels, and their distances; NaN: unknown."""
    count = draw(st.integers(1, 6))
    boxes = []
    for row in range(count):
        x0 = draw(st.integers(0, WH[0] - 1))
        y0 = draw(st.integers(0, WH[1] - 1))
        x1, y1 = draw(st.integers(x0 + 1, WH[0])), draw(st.integers(y0 + 1, WH[1]))
        # Most pixels are accepted, since boxes compete only for pixels that they share.
        pixels = hnp.arrays(np.bool_, (y1 - y0, x1 - x0), fill=st.just(True))
        around, inside, centred = draw(pixels), draw(pixels), draw(pixels)
        outline = Silhouette(row, x0, y0, x1, y1, inside, centred & inside)
        boxes.append(AcceptedPixels(outline, around & inside, around))
    metres = st.sampled_from([5.0, 10.0, 20.0, float("nan")])
    return boxes, np.array(draw(st.lists(metres, min_size=count, max_size=count)))


def in_image(box, mask):
    """The pixels of a mask of the box's region, as (x, y) in the image."""
    outline = box.silhouette
    return {(int(x) + outline.x0, int(y) + outline.y0) for y, x in np.argwhere(mask)}


def patches(pixels):
    """Split pixels into connected sets; pixels with a common corner are connected."""
    left = set(pixels)
    while left:
        island, edge = set(), {left.pop()}
        while edge:
            island |= edge
            near = {
                (x + dx, y + dy)
                for x, y in edge
                for dx in (-1, 0, 1)
                for dy in (-1, 0, 1)
            }
            edge = near & left
            left -= edge
        yield island


def slow_islands(box, behind):
    """Patches of a box's accepted pixels that more likely belong to a box behind it.

    They are small, do not touch the edge of the box's region, and lie within the
    accepted pixels of one box behind, of whose silhouette they are at least 1/50.
    """
    outline = box.silhouette
    own = in_image(box, box.own)
    all_of_them = list(patches(in_image(box, box.around)))
    most = max(len(patch & own) for patch in all_of_them)
    inner = {
        (x, y)
        for x in range(outline.x0 + 1, outline.x1 - 1)
        for y in range(outline.y0 + 1, outline.y1 - 1)
    }
    return [
        patch
        for patch in all_of_them
        if len(patch) <= most / 2
        and patch <= inner
        and any(
            patch <= in_image(other, other.mask)
            and len(patch) >= other.silhouette.pixels / 50
            for other in behind
        )
    ]


def slow_owned(boxes, distance, ids):
    """How many accepted pixels nearer boxes leave to each box; -1: no distance."""
    owner: dict[tuple[int, int], int] = {}
    tested = [row for row in range(len(boxes)) if not np.isnan(distance[row])]
    ranked = sorted(tested, key=lambda row: (distance[row], ids[row]))
    counts = [-1] * len(boxes)
    for rank, row in enumerate(ranked):
        box = boxes[row]
        free = in_image(box, box.mask) - owner.keys()
        counts[row] = len(free)
        if free:
            behind = [boxes[other] for other in ranked[rank + 1 :]]
            left = set().union(*slow_islands(box, behind))
            taken = (free & in_image(box, box.own)) - left
            owner.update(dict.fromkeys(taken, row))
    return counts


@given(frames_with_distances(), st.randoms())
def test_owned_pixels_equal_the_slow_definition_for_any_order_of_boxes(frame, dice):
    boxes, distance = frame
    # In the reverse order of the rows, so that ties are broken by id, not by row.
    ids = [f"b{row}" for row in range(len(boxes))][::-1]
    shuffled = list(boxes)
    dice.shuffle(shuffled)

    owned, explained = owned_pixels(boxes, distance, ids, WH)
    again, explained_again = owned_pixels(shuffled, distance, ids, WH)

    assert owned.tolist() == slow_owned(boxes, distance, ids)
    assert again.tolist() == owned.tolist()
    assert explained_again.tolist() == explained.tolist()


@given(
    hnp.arrays(np.bool_, (8, 12), elements=st.booleans()),
    st.integers(1, 11),
    st.integers(1, 7),
)
def test_islands_equal_the_slow_definition(scattered, width, height):
    whole = AcceptedPixels(Silhouette(0, 0, 0, *WH), scattered, scattered)
    part = scattered[:height, 12 - width :]
    outline = Silhouette(1, 12 - width, 0, 12, height)
    behind = [AcceptedPixels(outline, part, part)]

    pixels = islands(whole, behind, silhouette_bounds(behind))

    expected = set().union(*slow_islands(whole, behind)) if scattered.any() else set()
    assert (set() if pixels is None else in_image(whole, pixels)) == expected


angles = st.floats(-180, 180)
places = st.tuples(*[st.floats(-500, 500)] * 3)


@given(places, st.tuples(angles, angles, angles), st.floats(2, 90))
def test_depth_interval_is_unchanged_if_camera_and_box_move_together(
    place, turn, distance
):
    still = Camera.from_fov(64, 48, 90.0, Transform())
    moved = Camera.from_fov(64, 48, 90.0, Transform(place, turn))
    box = box_ahead(distance, half=1.0)
    matrix = transform_matrices([place], [turn])[0]
    carried = box @ matrix[:3, :3].T + matrix[:3, 3]

    first = depth_interval(box[None], still, 0.15)
    second = depth_interval(carried[None], moved, 0.15)

    np.testing.assert_allclose(first, second, atol=1e-6)


hull_points = hnp.arrays(
    np.float64, (8, 2), elements=st.floats(-4, 16).map(lambda v: round(v, 2))
)


@given(hull_points)
def test_touched_and_centred_pixels_are_those_of_the_hull(points):
    (touched,) = touched_pixels([points], np.array([[0, 0, *WH]]))
    (centred,) = centred_pixels([points], np.array([[0, 0, *WH]]))

    shares = np.random.default_rng(0).dirichlet(np.full(8, 0.4), 400)
    inside = shares @ points
    # OpenCV computes hulls in 32 bits, which is not exact next to a pixel's edge.
    clear = (np.abs(inside - np.round(inside)) > 1e-4).all(axis=1)
    seen = clear & ((inside >= 0) & (inside < WH)).all(axis=1)
    assert all(touched[y, x] for x, y in np.floor(inside[seen]).astype(int))
    assert not (centred & ~touched).any()
    hull: Any = cv2.convexHull(points.astype(np.float32))
    assume(hull is not None)
    for y, x in np.ndindex(centred.shape):
        depth = cv2.pointPolygonTest(hull, (x + 0.5, y + 0.5), measureDist=True)
        if abs(depth) > 1e-4:
            assert centred[y, x] == (depth > 0)


@st.composite
def outlines(draw):
    """The points of one shape, and the bounds of a region of the image."""
    points = hnp.arrays(
        np.float64,
        st.tuples(st.integers(1, 8), st.just(2)),
        elements=st.sampled_from([-3.0, 0.5, 2.0, 2.25, 7.0, 11.0]),
    )
    x0, y0 = draw(st.integers(0, WH[0] - 1)), draw(st.integers(0, WH[1] - 1))
    x1, y1 = draw(st.integers(x0 + 1, WH[0])), draw(st.integers(y0 + 1, WH[1]))
    return draw(points), (x0, y0, x1, y1)


@given(st.lists(outlines(), min_size=1, max_size=5))
def test_touched_pixels_of_several_shapes_equal_those_of_each_shape(shapes):
    points, bounds = zip(*shapes, strict=True)

    together = touched_pixels(points, np.array(bounds))

    for piece, part, mask in zip(points, bounds, together, strict=True):
        x0, y0, x1, y1 = part
        (whole,) = touched_pixels([piece], np.array([[0, 0, *WH]]))
        assert mask.tolist() == whole[y0:y1, x0:x1].tolist()


@settings(max_examples=50)
@given(
    hnp.arrays(np.float64, (30, 3), elements=st.floats(-6, 6)),
    st.floats(-180, 180),
    st.floats(0.5, 4),
)
def test_lidar_points_inside_a_box_equal_a_count_by_hand(xyz, yaw, half):
    corners = (
        box_ahead(0.0, half)
        @ transform_matrices([[0, 0, 0]], [[0, yaw, 0]])[0][:3, :3].T
    )
    tags = np.arange(30) % 3

    counted = points_inside(xyz, tags, Transform(), corners[None], np.array([0b110]))

    back = xyz @ transform_matrices([[0, 0, 0]], [[0, yaw, 0]])[0][:3, :3]
    gap = np.abs(np.abs(back).max(axis=1) - half)
    by_hand = (np.abs(back) <= half).all(axis=1) & (tags > 0)
    unsure = (gap < 1e-9).sum()
    assert abs(int(counted[0]) - int(by_hand.sum())) <= unsure
