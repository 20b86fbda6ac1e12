"""Projected rectangles equal clipping the six faces of a box at five planes."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from filter_core.geometry.box3d import in_carla_order
from filter_core.geometry.camera import Camera
from filter_core.geometry.projection import NEAR_PLANE, DepthStatus, project_boxes
from tests.support.geometry_oracle import box3d_vertices

WH = (320, 200)
CAMERA = Camera.from_fov(*WH, 90, {"x": 0, "y": 0, "z": 1.5})
OUTER = [[0, 1, 3, 2], [4, 5, 7, 6]]
FACES = [*OUTER, [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]
PLANES = np.array(
    [[1, 0, 0], [-1, 0, WH[0]], [0, 1, 0], [0, -1, WH[1]], [0, 0, 1]], dtype=float
)
OFFSETS = np.array([0, 0, 0, 0, -NEAR_PLANE])

TURNS = {"yaw": 180, "pitch": 30, "roll": 30}
places = st.fixed_dictionaries(
    {"x": st.floats(-6, 30), "y": st.floats(-15, 15), "z": st.floats(-3, 5)}
    | {name: st.floats(-most, most) for name, most in TURNS.items()}
)
extents = st.tuples(*[st.one_of(st.just(0.0), st.floats(0.05, 6))] * 3)
solids = st.builds(
    lambda place, extent: box3d_vertices(place, [0, 0, 0.5], extent, [0, 0, 0]),
    places,
    extents,
)


def slow_bounds(vertices, planes):
    """Bounds of the faces after Sutherland-Hodgman clipping; None: nothing is left."""
    matrix = CAMERA.world_to_image
    points = vertices @ matrix[:, :3].T + matrix[:, 3]
    seen = [point for face in FACES for point in clip_polygon(points[face], planes)]
    pixels = np.array([point[:2] / point[2] for point in seen])
    if len(pixels) == 0:
        return None
    return [*pixels.min(axis=0), *pixels.max(axis=0)]


def clip_polygon(polygon, planes):
    for normal, offset in planes:
        kept = []
        for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            before, after = start @ normal + offset, end @ normal + offset
            if before >= 0:
                kept.append(start)
            if (before >= 0) != (after >= 0):
                kept.append(start + before / (before - after) * (end - start))
        polygon = np.array(kept)
        if len(kept) == 0:
            return []
    return polygon


ALL_PLANES = list(zip(PLANES, OFFSETS, strict=True))


@given(vertices=solids)
def test_projected_rectangles_equal_polygon_clipping(vertices):
    """If the camera is inside a box, the faces alone still cover all of the image."""
    boxes = project_boxes(vertices, CAMERA)

    amodal = slow_bounds(vertices, [ALL_PLANES[-1]])
    visible = slow_bounds(vertices, ALL_PLANES)

    for row, slow in ((boxes.amodal_xyxy[0], amodal), (boxes.visible_xyxy[0], visible)):
        if slow is None or np.isnan(row).any():
            # They may differ only if a box touches the image in a line or a point.
            assert np.isnan(row).any() == (slow is None) or is_thin(row, slow)
        else:
            np.testing.assert_allclose(row, slow, rtol=1e-7, atol=1e-3)


def is_thin(row, slow):
    x0, y0, x1, y1 = row if slow is None else slow
    return min(x1 - x0, y1 - y0) < 1e-3


@given(vertices=solids, order=st.permutations(range(8)))
def test_in_carla_order_keeps_the_twelve_edges_for_any_corner_order(vertices, order):
    ordered = in_carla_order(vertices[order])[0]

    sides = [np.linalg.norm(ordered[a] - ordered[b]) for a, b in edge_pairs()]
    expected = [np.linalg.norm(vertices[a] - vertices[b]) for a, b in edge_pairs()]
    np.testing.assert_allclose(sorted(sides), sorted(expected), atol=1e-2)


def edge_pairs():
    return [(a, a | bit) for bit in (1, 2, 4) for a in range(8) if not a & bit]


@given(solid=st.lists(solids, max_size=6))
def test_projecting_a_frame_equals_projecting_each_box_alone(solid):
    vertices = np.array(solid).reshape(-1, 8, 3)
    before = vertices.copy()

    many = project_boxes(vertices, CAMERA)

    alone = [project_boxes(corners, CAMERA) for corners in vertices]
    for row, projected in enumerate(alone):
        # Sums over one box and over many may be rounded differently.
        expected = projected.visible_xyxy[0]
        np.testing.assert_allclose(many.visible_xyxy[row], expected, atol=1e-6)
        assert many.status[row] == projected.status[0]
    np.testing.assert_array_equal(vertices, before)


@given(vertices=solids, order=st.permutations(range(8)))
def test_projection_does_not_depend_on_the_order_of_corners(vertices, order):
    boxes = project_boxes(vertices, CAMERA)
    shuffled = project_boxes(vertices[order], CAMERA)

    for name in ("visible_xyxy", "amodal_xyxy", "distance", "status"):
        expected = getattr(boxes, name)
        np.testing.assert_allclose(getattr(shuffled, name), expected, rtol=1e-9)
    if boxes.status[0] != DepthStatus.BEHIND and np.isfinite(boxes.visible_xyxy).all():
        ends = boxes.edges[0].reshape(-1, 2)
        assert (ends >= boxes.visible_xyxy[0, :2] - 1e-6).all()
        assert (ends <= boxes.visible_xyxy[0, 2:] + 1e-6).all()
