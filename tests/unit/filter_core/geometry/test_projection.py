"""Projected 3D boxes, compared with CARLA's own library and exact clipping."""

import json

import numpy as np
import pytest

from filter_core.errors import FilterError
from filter_core.geometry.box3d import EDGES, in_carla_order
from filter_core.geometry.camera import Camera
from filter_core.geometry.projection import (
    DepthStatus,
    forward_distances,
    project_box,
    project_boxes,
)
from tests.support.geometry_oracle import (
    SMALL,
    box3d_vertices,
    camera_of,
    miss,
    vertices_of,
)
from tests.support.shared_data import shared

AHEAD = Camera.from_fov(1280, 720, 90, {"x": 0, "y": 0, "z": 0})


def unit_box(x=10.0, y=0.0, z=0.0, extent=(1, 1, 1)):
    return box3d_vertices({"x": x, "y": y, "z": z}, [0, 0, 0], extent, [0, 0, 0])


def check_clipped(case, order):
    truth = case["truth"]
    seen = project_box(vertices_of(case)[order], camera_of(case))

    assert miss(seen.visible_xyxy, truth["visible_box"]) <= 0.05
    assert miss(seen.amodal_xyxy, truth["amodal_box"]) <= 0.05
    assert seen.status.name.lower() == truth["status"]
    expected = truth["distance_camera_to_box_center"]
    assert seen.distance == pytest.approx(expected, abs=1e-3)


def check_carla(case):
    vertices = vertices_of(case)
    world = np.array(case["carla"]["world_vertices"])
    np.testing.assert_allclose(vertices, world, atol=2e-4)
    if case["truth"]["status"] != "in_front":
        return

    seen = vertices @ camera_of(case).world_to_image[:, :3].T
    seen += camera_of(case).world_to_image[:, 3]
    pixels = seen[:, :2] / seen[:, 2:]
    naive = project_box(vertices, camera_of(case), "naive").amodal_xyxy

    assert miss(pixels, case["carla"]["tutorial_pixels"]) <= 0.75
    assert miss(naive, case["carla"]["tutorial_minmax_box"]) <= 0.75


@pytest.mark.parametrize("case", SMALL, ids=lambda case: f"{case['id']}")
def test_some_cases_are_projected_exactly_and_as_by_carla(case):
    check_clipped(case, np.arange(8))
    check_clipped(case, np.random.default_rng(case["id"]).permutation(8))
    check_carla(case)


def test_all_240_cases_are_projected_exactly_and_as_by_carla():
    """Near depth 0 CARLA's tutorial depends on its float32, hence the tolerance."""
    cases = json.loads(shared("oracles/geometry.json").read_text())["cases"]
    rng = np.random.default_rng(0)

    for case in cases:
        check_clipped(case, np.arange(8))
        check_clipped(case, rng.permutation(8))
        check_carla(case)
        vertices, camera, carla = vertices_of(case), camera_of(case), case["carla"]
        (forward,) = forward_distances(vertices[None], camera)
        assert forward == pytest.approx(np.mean(carla["vertex_depth"]), abs=1e-3)
        naive = project_boxes(vertices, camera, "naive").amodal_xyxy
        beam = [carla["tutorial_minmax_box"]]
        np.testing.assert_allclose(naive, beam, rtol=0.005, atol=0.75)

    assert len(cases) == 240


def test_project_boxes_equals_project_box_of_each_box():
    cases = SMALL
    camera = camera_of(cases[0])
    vertices = np.array([vertices_of(case) for case in cases])

    many = project_boxes(vertices, camera)

    for row, corners in enumerate(vertices):
        alone = project_box(corners, camera)
        nothing = [np.nan] * 4
        visible = nothing if alone.visible_xyxy is None else alone.visible_xyxy
        np.testing.assert_array_equal(many.visible_xyxy[row], visible)
        np.testing.assert_array_equal(many.edges[row], alone.edges)


def test_a_box_behind_the_camera_has_no_rectangle_and_no_edges():
    seen = project_box(unit_box(x=-10), AHEAD)

    assert seen.status is DepthStatus.BEHIND
    assert (seen.visible_xyxy, seen.amodal_xyxy, len(seen.edges)) == (None, None, 0)
    assert seen.distance == pytest.approx(10)
    none = project_boxes([], AHEAD)
    assert (len(none), none.visible_xyxy.shape, none.edges) == (0, (0, 4), [])


def test_a_box_ahead_has_all_twelve_edges_inside_its_rectangle():
    seen = project_boxes(unit_box(), AHEAD)

    assert seen.edges[0].shape == (12, 4)
    ends = seen.edges[0].reshape(-1, 2)
    bounds = [*ends.min(axis=0), *ends.max(axis=0)]
    np.testing.assert_allclose([bounds], seen.visible_xyxy)


def test_edges_are_clipped_to_the_near_plane_and_the_image():
    seen = project_box(unit_box(x=0.5, extent=(2, 1, 1)), AHEAD)

    ends = seen.edges.reshape(-1, 2)
    assert 0 < len(seen.edges) < 12
    assert (ends >= 0).all()
    assert (ends <= [1280, 720]).all()


def test_eight_points_that_are_not_a_box_keep_their_order():
    points = np.random.default_rng(5).uniform(9, 11, (8, 3)) - np.array([0, 10, 10])

    seen = project_box(points, AHEAD)

    np.testing.assert_array_equal(in_carla_order(points)[0], points)
    assert seen.visible_xyxy is not None


@pytest.mark.parametrize("extent", [(1, 0, 1), (0, 1, 1), (0, 0, 1), (-1, 1, -1)])
def test_flat_and_mirrored_boxes_are_projected(extent):
    seen = project_boxes(unit_box(y=1, z=1, extent=extent), AHEAD)

    mirrored = project_boxes(unit_box(y=1, z=1, extent=np.abs(extent)), AHEAD)
    np.testing.assert_allclose(seen.visible_xyxy, mirrored.visible_xyxy)
    assert seen.status.tolist() == [DepthStatus.IN_FRONT]
    point = project_box(unit_box(extent=(0, 0, 0)), AHEAD)
    np.testing.assert_array_equal(point.visible_xyxy, [640, 360, 640, 360])


def test_naive_projection_of_a_corner_in_the_camera_plane_is_finite():
    seen = project_boxes(unit_box(x=1, y=0.5), AHEAD, "naive")

    assert np.isfinite(seen.amodal_xyxy).all()
    assert seen.visible_xyxy[:, [0, 2]].tolist() == [[0, 1280]]
    beside = project_boxes(unit_box(y=100), AHEAD, "naive")
    assert np.isnan(beside.visible_xyxy).all()
    assert (beside.amodal_xyxy[:, 0] > 1280).all()


def test_edges_differ_in_one_axis():
    assert sorted({int(a ^ b) for a, b in EDGES}) == [1, 2, 4]
    assert len({(int(a), int(b)) for a, b in EDGES}) == 12


@pytest.mark.parametrize(
    ("points", "mode", "words"),
    [
        (8, "exact", "expected clipped or naive, found 'exact'"),
        (7, "clipped", r"shape \(N, 8, 3\), found \(7, 3\)"),
    ],
)
def test_unknown_projection_or_number_of_points_is_refused(points, mode, words):
    with pytest.raises(FilterError, match=words):
        project_box(unit_box()[:points], AHEAD, mode)
