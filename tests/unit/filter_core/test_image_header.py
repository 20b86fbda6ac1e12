"""What is believed of a file before anything is decoded."""

import struct

import cv2
import numpy as np
import pytest

from filter_core.errors import ImageError, ImageSizeMismatch, ImageTooLarge
from filter_core.image_header import ImageHeader, read_image_header, require_size
from tests.pictures import chunk, indexed_png, jpeg, png, png_of_chunks, with_alpha

GREY = np.zeros((3, 5), np.uint8)
RGB = np.zeros((3, 5, 3), np.uint8)
PIXELS = chunk(b"IDAT", b"")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        pytest.param(png(GREY), ("image/png", 5, 3, 8, 1, "grey"), id="grey PNG"),
        pytest.param(png(RGB), ("image/png", 5, 3, 8, 3, "rgb"), id="RGB PNG"),
        pytest.param(
            png(with_alpha(RGB)), ("image/png", 5, 3, 8, 4, "rgba"), id="RGBA PNG"
        ),
        pytest.param(
            png(GREY.astype(np.uint16)),
            ("image/png", 5, 3, 16, 1, "grey"),
            id="16-bit PNG",
        ),
        pytest.param(
            indexed_png(GREY, np.zeros((1, 3))),
            ("image/png", 5, 3, 8, 1, "indexed"),
            id="indexed PNG",
        ),
        pytest.param(jpeg(RGB), ("image/jpeg", 5, 3, 8, 3, "rgb"), id="JPEG"),
        pytest.param(
            cv2.imencode(".jpg", GREY)[1].tobytes(),
            ("image/jpeg", 5, 3, 8, 1, "grey"),
            id="grey JPEG",
        ),
    ],
)
def test_the_header_is_read_from_the_content(content, expected):
    assert read_image_header(content) == ImageHeader(*expected)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        pytest.param(b"", "found no bytes", id="nothing"),
        pytest.param(b"GIF89a....", "neither|expected a PNG or JPEG", id="a GIF"),
        pytest.param(b"<html><body>", "begin with b'<html><b'", id="a web page"),
        pytest.param(png(RGB)[:-1], "ends too early", id="PNG without its last byte"),
        pytest.param(png(RGB)[:40], "ends too early", id="PNG cut inside its pixels"),
        pytest.param(png(RGB)[:8], "ends too early", id="PNG of a signature alone"),
        pytest.param(jpeg(RGB)[:-2], "ends too early", id="JPEG without its end"),
        pytest.param(jpeg(RGB)[:30] + b"\xff\xd9", "ends too early", id="JPEG cut"),
        pytest.param(b"\xff\xd8\xff\xd9", "no header", id="JPEG without a frame"),
        pytest.param(
            png_of_chunks((5, 3, 8, 2), chunk(b"acTL", bytes(8)), PIXELS),
            "animated",
            id="animated PNG",
        ),
        pytest.param(png_of_chunks((5, 3, 8, 2)), "no pixels", id="PNG, no pixels"),
        pytest.param(
            png_of_chunks((5, 3, 8, 1), PIXELS), "colour type 1", id="PNG of no kind"
        ),
        pytest.param(
            png_of_chunks((5, 3, 7, 2), PIXELS), "bit depth 7", id="PNG of 7 bits"
        ),
        pytest.param(
            png_of_chunks((0, 3, 8, 2), PIXELS), "0 x 3 pixels", id="PNG without width"
        ),
        pytest.param(
            b"\x89PNG\r\n\x1a\n" + chunk(b"tEXt", b"x" * 20) + chunk(b"IEND"),
            "header of 13 bytes first",
            id="PNG without a header",
        ),
    ],
)
def test_what_is_no_usable_image_is_refused(content, message):
    with pytest.raises(ImageError, match=message):
        read_image_header(content)


@pytest.mark.parametrize("side", [70_000, 2**31 - 1])
def test_a_header_that_asks_for_gigabytes_is_refused_before_decoding(side):
    bomb = png_of_chunks((side, 4, 8, 6), PIXELS)

    with pytest.raises(ImageTooLarge, match=f"{side} x 4 pixels, no side may exceed"):
        read_image_header(bomb)


def test_the_limit_is_the_callers():
    with pytest.raises(ImageTooLarge, match="5 x 3 pixels, no side may exceed 4"):
        read_image_header(png(RGB), max_side=4)


def test_another_size_is_an_error_that_says_both():
    header = read_image_header(png(RGB))

    with pytest.raises(ImageSizeMismatch) as caught:
        require_size(header, (1280, 720), what="the segmentation", than="the image")

    assert str(caught.value) == (
        "the segmentation is 5 x 3 pixels, the image is 1280 x 720"
    )


def test_padding_and_markers_without_a_body_are_passed_over():
    content = jpeg(RGB)
    padded = content[:2] + b"\xff\xff\xff\xd0\xff\x01" + content[2:]

    assert read_image_header(padded) == read_image_header(content)


def test_a_rotation_in_exif_does_not_turn_the_size():
    # A TIFF header with one entry: orientation, a number, one of them, 6 (90 degrees).
    tiff = b"MM\x00*" + struct.pack(">IHHHIHHI", 8, 1, 0x0112, 3, 1, 6, 0, 0)
    body = b"Exif\x00\x00" + tiff
    segment = b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body
    content = jpeg(RGB)

    assert read_image_header(content[:2] + segment + content[2:]).wh == (5, 3)
