"""Depth images: reading metres, refusing coarse files, counting a box's own pixels."""

import cv2
import numpy as np
import pytest

from filter_core.errors import ImageError, ImageSizeMismatch
from filter_core.evidence.depth import (
    center_gaps,
    depth_interval,
    fill_depth,
    read_depth,
    settled_depth,
)
from filter_core.evidence.silhouettes import AcceptedPixels, Silhouette
from filter_core.evidence_numbers import ChannelNumbers
from filter_core.geometry.camera import Camera
from tests.support.pictures import jpeg, pixels_of, png, with_alpha
from tests.support.sensors import box_ahead, depth_png, street_metres

ALL_PIXELS = np.s_[:, :]
CAMERA = Camera.from_fov(64, 48, 90.0, {"x": 0, "y": 0, "z": 0})


@pytest.mark.parametrize("metres", [0.0, 0.06, 3.9, 12.5, 255.999, 1000.0])
def test_depth_is_read_with_0_1_millimetre_accuracy(metres):
    image = read_depth(depth_png(np.full((2, 3), metres)))

    assert image.wh == (3, 2)
    np.testing.assert_allclose(image.metres(ALL_PIXELS), metres, atol=1e-4)


STREET = street_metres()
RAW = pixels_of(depth_png(STREET))
LINEAR = np.rint(STREET / 1000 * 255).astype(np.uint8)
LOGARITHM = (1 + np.log(STREET / 1000) / 5.70378).clip(0, 1)
LOGARITHMIC = np.rint(255 * LOGARITHM).astype(np.uint8)
NOISE = np.random.default_rng(1).integers(0, 256, (*STREET.shape, 3)).astype(np.uint8)
RAINBOW = cv2.applyColorMap(LOGARITHMIC, cv2.COLORMAP_JET)


@pytest.mark.parametrize(
    ("pixels", "encoding"),
    [(RAW, "carla"), (RAW[..., ::-1], "carla-bgr"), (with_alpha(RAW), "carla")],
    ids=["raw", "swapped", "alpha"],
)
@pytest.mark.parametrize("named", [False, True])
def test_order_of_channels_is_recognised_by_content(pixels, encoding, named):
    image = read_depth(png(pixels, "bgr"), encoding if named else "auto")

    assert (image.encoding, image.is_certain) == (encoding, True)
    assert len(image.notes) == (encoding == "carla-bgr")
    np.testing.assert_allclose(image.metres(ALL_PIXELS), STREET, atol=1e-4)


@pytest.mark.parametrize(
    ("pixels", "encoding", "code", "words"),
    [
        (np.zeros((4, 4), np.uint8), "auto", "depth_too_coarse", "3.9 m"),
        (np.zeros((4, 4, 3), np.uint16), "auto", "unknown_depth", "16 bits"),
        (np.dstack([LINEAR] * 3), "auto", "depth_too_coarse", None),
        (np.dstack([LOGARITHMIC] * 3), "auto", "depth_too_coarse", None),
        (cv2.GaussianBlur(NOISE, (0, 0), 5), "auto", "unknown_depth", None),
        (NOISE, "auto", "unknown_depth", None),
        (RAINBOW, "auto", "unknown_depth", None),
        (RAW[..., [0, 2, 1]], "auto", "unknown_depth", r"\(green\)"),
        (RAW[..., [1, 2, 0]], "auto", "unknown_depth", r"\(green\)"),
        (RAW, "carla-bgr", "unknown_depth", None),
        (RAW[..., ::-1], "carla", "unknown_depth", None),
        (np.dstack([LINEAR] * 3), "carla", "depth_too_coarse", None),
        (RAW, "millimetres16", "unknown_depth", None),
        (STREET.astype(np.uint16), "carla", "unknown_depth", None),
        (STREET.astype(np.uint16), "metres16", "depth_too_coarse", None),
        (LINEAR, "linear8", "depth_too_coarse", None),
        (RAW, "log8", "depth_too_coarse", None),
    ],
)
def test_image_that_is_no_raw_depth_or_not_of_the_named_encoding_is_refused(
    pixels, encoding, code, words
):
    with pytest.raises(ImageError, match=words) as refused:
        read_depth(png(pixels, "bgr"), encoding)

    assert refused.value.kind == code


def test_jpeg_and_image_of_wrong_size_are_refused():
    with pytest.raises(ImageError, match="JPEG") as refused:
        read_depth(jpeg(np.zeros((8, 8, 3), np.uint8)))
    assert refused.value.kind == "lossy_depth"
    with pytest.raises(ImageSizeMismatch, match="depth image is 3 x 2"):
        read_depth(depth_png(np.ones((2, 3))), expected_wh=(4, 2))


def whole(row: int) -> AcceptedPixels:
    """A box whose pixels are all of an image of 64 x 48, and are all accepted."""
    return AcceptedPixels(Silhouette(row, 0, 0, 64, 48), np.ones((48, 64), bool))


def settled(content: bytes, low: float, high: float):
    """The image of 64 x 48 as one box shows it."""
    return settled_depth(read_depth(content), [whole(0)], np.array([[low, high]]))


FLAT = pixels_of(depth_png(np.full((48, 64), 5.0)))


@pytest.mark.parametrize(
    ("order", "encoding"), [("rgb", "carla"), ("bgr", "carla-bgr")]
)
def test_box_or_name_tells_the_order_of_a_flat_image(order, encoding):
    content = png(FLAT[..., ::-1], order)
    by_box, by_name = settled(content, 4.0, 6.0), read_depth(content, encoding)

    assert by_box.encoding == by_name.encoding == encoding
    for image in (by_box, by_name):
        np.testing.assert_allclose(image.metres(ALL_PIXELS), 5.0, atol=1e-4)
    with pytest.raises(ImageError, match="none of the boxes") as refused:
        settled(content, 20.0, 24.0)
    assert refused.value.kind == "unknown_depth"


@pytest.mark.parametrize(("metres", "is_refused"), [(5.0, True), (9.0, False)])
def test_millimetres_of_24_bits_are_told_by_the_boxes(metres, is_refused):
    rows = np.linspace(metres - 0.9, metres + 0.9, 48 * 64).reshape(48, 64)
    noise = np.random.default_rng(1).integers(0, 300, (48, 64))
    steps = (1000 * rows).astype(np.int64) + noise
    rgb = np.stack([steps >> shift & 255 for shift in (0, 8, 16)], axis=-1)
    content = png(rgb.astype(np.uint8))

    if not is_refused:
        assert settled(content, 4.0, 6.0).encoding == "carla"
        return
    with pytest.raises(ImageError, match="24 bits are millimetres") as refused:
        settled(content, 4.0, 6.0)
    assert refused.value.kind == "unknown_depth"


def test_sixteen_bits_are_millimetres_where_boxes_show_it():
    content = png(np.full((48, 64), 5_000, np.uint16))

    image = settled(content, 4.0, 6.0)

    assert image.encoding == "millimetres16"
    np.testing.assert_allclose(image.metres(ALL_PIXELS), 5.0, atol=1e-3)
    with pytest.raises(ImageError, match="0 of 1 boxes"):
        settled(content, 9.0, 11.0)


def test_sixteen_bits_tell_nothing_of_far_boxes_and_unknown_pixels():
    both = np.stack([box_ahead(metres, half=2.0) for metres in (20.0, 90.0)])
    interval = depth_interval(both, CAMERA, 0.15)
    numbers = {}
    for name, value in (("known", 65_535), ("unknown", 0)):
        depth = read_depth(png(np.full((48, 64), value, np.uint16)), "millimetres16")
        numbers[name] = ChannelNumbers.absent(2)
        fill_depth(numbers[name], [whole(0), whole(1)], depth, interval)
        numbers[name].center_gap[:] = center_gaps(both, CAMERA, depth)

    assert numbers["known"].depth_pixels.tolist() == [0, -1]
    assert np.isnan(numbers["known"].center_gap).tolist() == [False, True]
    assert numbers["unknown"].depth_pixels.tolist() == [-1, -1]
    assert np.isnan(numbers["unknown"].center_gap).all()


def test_only_accepted_pixels_at_the_boxs_own_depth_count():
    depth = read_depth(depth_png(np.array([[5.0, 10.0, 10.5, 30.0, 10.2]])))
    accepted = np.array([[True, True, True, True, False]])
    boxes = [AcceptedPixels(Silhouette(row, 0, 0, 5, 1), accepted) for row in range(2)]
    numbers = ChannelNumbers.absent(2)

    fill_depth(numbers, boxes, depth, np.array([[9.5, 11.0], [np.nan, np.nan]]))

    # The second box has no interval of depth, and is not measured.
    assert numbers.depth_pixels.tolist() == [2, -1]
    assert numbers.nearer_percent[0] == 20.0
    assert numbers.tight_xyxy[0].tolist() == [1.0, 0.0, 3.0, 1.0]


def test_depth_interval_spans_the_corners_plus_tolerance():
    interval = depth_interval(box_ahead(20.0, half=2.0)[None], CAMERA, 0.15)

    np.testing.assert_allclose(interval, [[17.85, 22.15]])


@pytest.mark.parametrize(
    ("box", "surface", "gap"),
    [
        (box_ahead(20.0, half=2.0), 10.0, 8.0),
        (box_ahead(20.0, half=2.0), 18.5, -0.5),
        (box_ahead(20.0, half=2.0), 40.0, -22.0),
        # Its centre is not in the image: behind the camera, and beside the image.
        (box_ahead(-20.0, half=2.0), 5.0, np.nan),
        (box_ahead(20.0, half=2.0, right=21.0), 5.0, np.nan),
    ],
)
def test_center_gap_is_nearest_corner_minus_surface_at_the_centre(box, surface, gap):
    depth = read_depth(depth_png(np.full((48, 64), surface)))

    gaps = center_gaps(box[None], CAMERA, depth)

    np.testing.assert_allclose(gaps, [gap], atol=1e-3)
