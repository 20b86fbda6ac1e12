"""Turning annotations into the 2D rectangles that the filter measures."""

from dataclasses import replace

import numpy as np
import pytest

from filter_core.annotation.frame import frame_boxes_2d
from filter_core.annotation.parsing import parse_annotation
from filter_core.errors import AnnotationError, ImageSizeMismatch
from filter_core.evidence_numbers import BoxState
from filter_core.geometry.boxes import correct_xyxy

WH = (1280, 720)
ORIGIN = {"x": 0, "y": 0, "z": 0}
CAMERA = {"width": 1280, "height": 720, "fov": 90, "transform": ORIGIN}
FLAT = {"class": "car", "xywh": [10, 20, 30, 40]}


def make_3d_box(x, y=0.0, **keys):
    place = {"x": x, "y": y, "z": 0}
    return {"class": "car", "box3d": {"transform": place, "extent": [1, 1, 1]}, **keys}


def geometry_of(*boxes, projection="clipped", **frame):
    annotation = parse_annotation({"boxes": list(boxes), "camera": CAMERA, **frame})
    return frame_boxes_2d(annotation, WH, projection)


def test_all_2d_forms_are_converted_to_xyxy_in_box_order():
    geometry = geometry_of(
        {"class": "a", "cxcywhn": [0.5, 0.5, 0.5, 0.5]},
        FLAT,
        {"class": "a", "xyxy": [1, 2, 3, 4]},
        {"class": "a", "xyxyn": [0, 0, 1, 1]},
        {"class": "a", "cxcywh": [10, 10, 4, 2]},
    )

    assert geometry.xyxy.tolist() == [
        [320, 180, 960, 540],
        [10, 20, 40, 60],
        [1, 2, 3, 4],
        [0, 0, 1280, 720],
        [8, 9, 12, 11],
    ]
    assert geometry.edges == [None] * 5
    assert np.isnan(geometry.visible_xyxy).all()


def test_3d_box_xyxy_is_its_visible_rectangle_unless_projected_naively():
    geometry = geometry_of(FLAT, make_3d_box(10, y=10))

    np.testing.assert_array_equal(geometry.xyxy[1], geometry.visible_xyxy[1])
    assert geometry.amodal_xyxy[1, 2] > geometry.visible_xyxy[1, 2] == 1280
    assert geometry.edges[0] is None
    assert geometry.edges[1] is not None
    assert np.isnan(geometry.vertices[0]).all()
    assert np.isfinite(geometry.vertices[1]).all()
    naive = geometry_of(make_3d_box(10, y=10), projection="naive")
    np.testing.assert_array_equal(naive.xyxy, naive.amodal_xyxy)
    assert naive.xyxy[0, 2] > 1280


def test_vertices_and_box3d_of_same_box_give_same_rectangle():
    by_box = geometry_of(make_3d_box(10))
    corners = by_box.vertices[0].tolist()

    by_corners = geometry_of({"class": "car", "vertices": corners})

    np.testing.assert_allclose(by_corners.xyxy, by_box.xyxy)


@pytest.mark.parametrize("box", [make_3d_box(-10), make_3d_box(10, y=100)])
@pytest.mark.parametrize("profile", ["paper", "carlasimu"])
def test_box_behind_or_beside_camera_is_outside_image(box, profile):
    geometry = geometry_of(box)

    _, states = correct_xyxy(geometry.xyxy, WH, profile)

    assert states.tolist() == [BoxState.OUTSIDE_IMAGE]
    assert np.isnan(geometry.visible_xyxy).all()


def test_distance_is_given_or_computed_from_3d_box_or_nan():
    geometry = geometry_of(
        FLAT, {**FLAT, "distance": 3}, make_3d_box(3, y=4), make_3d_box(3, distance=9)
    )

    np.testing.assert_allclose(geometry.distance, [np.nan, 3, 5, 9])


def test_a_frame_without_boxes_has_empty_arrays():
    geometry = geometry_of()

    assert len(geometry) == 0
    assert (geometry.xyxy.shape, geometry.vertices.shape) == ((0, 4), (0, 8, 3))


def test_image_of_another_size_and_3d_box_without_camera_are_refused():
    box = {**make_3d_box(10), "id": "7"}
    annotation = parse_annotation({"boxes": [box], "camera": CAMERA})

    words = "camera: expected 640 x 360 px, the image's size, found 1280 x 720 px"
    with pytest.raises(ImageSizeMismatch, match=words):
        frame_boxes_2d(annotation, (640, 360))
    words = r'box 0 \(id "7"\), box3d: expected a cam'
    with pytest.raises(AnnotationError, match=words):
        frame_boxes_2d(replace(annotation, camera=None), WH)
