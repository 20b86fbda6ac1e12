"""Depth images: reading metres, refusing coarse files, counting a box's own pixels."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from filter_core.errors import ImageError, ImageSizeMismatch
from filter_core.evidence.depth import (
    center_gaps,
    depth_interval,
    fill_depth,
    read_depth,
    tight_rectangle,
)
from filter_core.evidence.silhouettes import AcceptedPixels, Silhouette
from filter_core.geometry.camera import Camera
from filter_core.types import ChannelNumbers
from tests.support.sensors import box_ahead, depth_png

ALL_PIXELS = np.s_[:, :]


@pytest.mark.parametrize("metres", [0.0, 0.06, 3.9, 12.5, 255.999, 1000.0])
def test_depth_is_read_with_0_1_millimetre_accuracy(metres):
    image = read_depth(depth_png(np.full((2, 3), metres)))

    assert image.wh == (3, 2)
    np.testing.assert_allclose(image.metres(ALL_PIXELS), metres, atol=1e-4)


def test_alpha_channel_of_a_depth_image_is_ignored():
    rgb = cv2.imdecode(np.frombuffer(depth_png(np.full((2, 2), 7.0)), np.uint8), -1)
    assert rgb is not None
    rgba = cv2.cvtColor(rgb, cv2.COLOR_BGR2BGRA)

    image = read_depth(cv2.imencode(".png", rgba)[1].tobytes())

    np.testing.assert_allclose(image.metres(ALL_PIXELS), 7.0, atol=1e-4)


@pytest.mark.parametrize(
    ("extension", "pixels", "code", "words"),
    [
        (".png", np.zeros((4, 4), np.uint8), "depth_too_coarse", "3.9 m"),
        (".png", np.zeros((4, 4), np.uint16), "depth_too_coarse", "16 bits"),
        (".jpg", np.zeros((8, 8, 3), np.uint8), "lossy_depth", "JPEG"),
    ],
    ids=["converted for people", "sixteen bits", "jpeg"],
)
def test_too_coarse_or_lossy_depth_is_refused(extension, pixels, code, words):
    with pytest.raises(ImageError, match=words) as refused:
        read_depth(cv2.imencode(extension, pixels)[1].tobytes())

    assert refused.value.kind == code


def test_depth_image_of_wrong_size_is_refused():
    with pytest.raises(ImageSizeMismatch, match="depth image is 3 x 2"):
        read_depth(depth_png(np.ones((2, 3))), expected_wh=(4, 2))


def test_only_accepted_pixels_at_the_boxs_own_depth_count():
    depth = read_depth(depth_png(np.array([[5.0, 10.0, 10.5, 30.0, 10.2]])))
    accepted = np.array([[True, True, True, True, False]])
    numbers = ChannelNumbers.absent(1)

    fill_depth(
        numbers,
        [AcceptedPixels(Silhouette(0, 0, 0, 5, 1), accepted)],
        depth,
        np.array([[9.5, 11.0]]),
    )

    assert numbers.depth_pixels.tolist() == [2]
    assert numbers.nearer_percent.tolist() == [20.0]
    assert numbers.tight_xyxy.tolist() == [[1.0, 0.0, 3.0, 1.0]]


def test_box_without_a_depth_interval_is_not_measured():
    depth = read_depth(depth_png(np.ones((1, 1))))
    numbers = ChannelNumbers.absent(1)

    fill_depth(
        numbers,
        [AcceptedPixels(Silhouette(0, 0, 0, 1, 1), np.ones((1, 1), bool))],
        depth,
        np.full((1, 2), np.nan),
    )

    assert numbers.depth_pixels.tolist() == [-1]


def test_depth_interval_spans_the_corners_plus_tolerance():
    camera = Camera.from_fov(64, 48, 90.0, {"x": 0, "y": 0, "z": 0})

    interval = depth_interval(box_ahead(20.0, half=2.0)[None], camera, 0.15)

    np.testing.assert_allclose(interval, [[17.85, 22.15]])


@pytest.mark.parametrize(("surface", "gap"), [(10.0, 8.0), (18.5, -0.5), (40.0, -22.0)])
def test_center_gap_is_nearest_corner_minus_surface_at_the_centre(surface, gap):
    camera = Camera.from_fov(64, 48, 90.0, {"x": 0, "y": 0, "z": 0})
    depth = read_depth(depth_png(np.full((48, 64), surface)))

    gaps = center_gaps(box_ahead(20.0, half=2.0)[None], camera, depth)

    np.testing.assert_allclose(gaps, [gap], atol=1e-3)


@pytest.mark.parametrize(
    "box",
    [
        pytest.param(box_ahead(-20.0, half=2.0), id="behind the camera"),
        pytest.param(box_ahead(20.0, half=2.0, right=21.0), id="beside the image"),
    ],
)
def test_center_gap_is_nan_where_the_centre_is_not_in_the_image(box):
    camera = Camera.from_fov(64, 48, 90.0, {"x": 0, "y": 0, "z": 0})
    depth = read_depth(depth_png(np.full((48, 64), 5.0)))

    gaps = center_gaps(box[None], camera, depth)

    assert np.isnan(gaps).all()


def test_tight_rectangle_of_an_empty_mask_is_nan():
    assert np.isnan(tight_rectangle(np.zeros((3, 3), bool), 7, 9)).all()
