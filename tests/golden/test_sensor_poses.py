"""Sensors that stand elsewhere than the camera, against CARLA's own matrices."""

import json

import numpy as np
import pytest

from filter_core.evidence.depth import depth_interval
from filter_core.evidence.lidar import points_inside
from filter_core.geometry.pose import as_transform
from tests.support.geometry_oracle import camera_of
from tests.support.shared_data import shared

CAR = 14
SOLID_M = 0.05
"""Boxes thinner than this have no inside to speak of."""


@pytest.fixture(scope="module")
def cases():
    return json.loads(shared("oracles/geometry.json").read_text("utf-8"))["cases"]


def test_points_inside_a_box_are_counted_for_any_sensor_pose(cases):
    dice = np.random.default_rng(7)
    for case in cases:
        vertices = np.array(case["truth"]["world_vertices_f64"])
        if min(case["bounding_box"]["extent"]) < SOLID_M:
            continue
        centre = vertices.mean(axis=0)
        inside = centre + (vertices - centre) * dice.uniform(0, 0.95, (8, 1))
        beside = centre + (vertices - centre) * dice.uniform(1.05, 2, (8, 1))
        inverse = np.array(case["carla"]["camera_inverse_matrix"])
        in_axes = np.concatenate([inside, beside]) @ inverse[:3, :3].T + inverse[:3, 3]

        counted = points_inside(
            in_axes,
            np.full(16, CAR),
            as_transform(case["camera"]),
            vertices[None],
            np.array([1 << CAR]),
        )

        assert counted.tolist() == [8], case["id"]


def test_depth_interval_matches_the_vertex_depths_of_carla(cases):
    for case in cases:
        camera = camera_of(case)
        vertices = np.array(case["truth"]["world_vertices_f64"])
        depth = np.array(case["carla"]["vertex_depth"])

        near, far = depth_interval(vertices[None], camera, 0.0)[0]

        assert far == pytest.approx(depth.max(), abs=1e-3), case["id"]
        assert near == pytest.approx(max(depth.min(), 0.1), abs=1e-3), case["id"]
