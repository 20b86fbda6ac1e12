"""Colour images decoded by imagecodecs and OpenCV: the same pixels and faults."""

from __future__ import annotations

import struct
import zlib
from unittest.mock import patch

import cv2
import numpy as np
import pytest

from filter_core import color_decoding
from filter_core.color_decoding import decode_color, png_decoder
from filter_core.errors import ImageError
from filter_core.image_header import read_image_header

SIGNATURE = b"\x89PNG\r\n\x1a\n"
WIDTH, HEIGHT = 37, 23
RGB, RGBA, INDEXED, GREY = 2, 6, 3, 0
RNG = np.random.default_rng(2026)
PIXELS = RNG.integers(0, 256, (HEIGHT, WIDTH, 4), np.uint8)
PASSES = [(0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4)]
PASSES += [(2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1)]
"""First row, first column, and the steps to the next, of an interlaced PNG."""


def chunk(kind: bytes, body: bytes) -> bytes:
    checksum = zlib.crc32(kind + body)
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", checksum)


def rows(pixels: np.ndarray) -> bytes:
    return b"".join(b"\0" + row.tobytes() for row in pixels)


def png(pixels, color_type, *extra: bytes, depth=8, interlaced=False) -> bytes:
    height, width = pixels.shape[:2]
    raw = rows(pixels)
    if interlaced:
        raw = b"".join(rows(pixels[y::dy, x::dx]) for y, x, dy, dx in PASSES)
    head = struct.pack(">IIBBBBB", width, height, depth, color_type, 0, 0, interlaced)
    parts = [chunk(b"IHDR", head), *extra, chunk(b"IDAT", zlib.compress(raw))]
    return SIGNATURE + b"".join(parts) + chunk(b"IEND", b"")


FILES = {
    "rgb": png(PIXELS[..., :3], RGB),
    "rgba": png(PIXELS, RGBA),
    "rgb with a transparent colour": png(
        PIXELS[..., :3], RGB, chunk(b"tRNS", struct.pack(">3H", *PIXELS[0, 0, :3]))
    ),
    "rgb with a gamma": png(
        PIXELS[..., :3], RGB, chunk(b"gAMA", struct.pack(">I", 100_000))
    ),
    "rgb with fewer significant bits": png(
        PIXELS[..., :3], RGB, chunk(b"sBIT", b"\5\6\5")
    ),
    "interlaced": png(PIXELS[..., :3], RGB, interlaced=True),
    "16 bits": png(PIXELS[..., :3].astype(">u2") * 257, RGB, depth=16),
    "indexed": png(PIXELS[..., 0], INDEXED, chunk(b"PLTE", bytes(range(256)) * 3)),
    "grey": png(PIXELS[..., 0], GREY),
    "followed by notes": png(PIXELS[..., :3], RGB) + b"notes of an editor",
    "jpeg": cv2.imencode(".jpg", PIXELS[..., :3])[1].tobytes(),
    "filtered": cv2.imencode(".png", np.sort(PIXELS, 1)[..., :3])[1].tobytes(),
}
PLAIN = ("rgb", "rgba", "filtered")


def decoded(content, order):
    try:
        return decode_color(content, read_image_header(content), order)
    except ImageError as error:
        return str(error)


def by_opencv(content, order):
    with patch.object(color_decoding, "png_decoder", lambda: None):
        return decoded(content, order)


@pytest.mark.parametrize("order", ["rgb", "bgr"])
@pytest.mark.parametrize("content", FILES.values(), ids=list(FILES))
def test_a_file_has_the_same_pixels_whoever_decodes_it(content, order):
    found = decoded(content, order)

    assert found.shape == (HEIGHT, WIDTH, 3)
    assert found.dtype == np.uint8
    assert found.flags.c_contiguous
    np.testing.assert_array_equal(found, by_opencv(content, order))


@pytest.mark.parametrize("name", PLAIN)
def test_what_carla_writes_is_decoded_the_fast_way(name):
    asked = []
    faster = png_decoder()
    assert faster is not None

    def decoder(content):
        asked.append(content)
        return faster(content)

    with patch.object(color_decoding, "png_decoder", lambda: decoder):
        decoded(FILES[name], "rgb")

    assert asked == [FILES[name]]


def test_pixels_are_those_that_were_written():
    np.testing.assert_array_equal(decoded(FILES["rgba"], "rgb"), PIXELS[..., :3])
    np.testing.assert_array_equal(decoded(FILES["rgb"], "bgr"), PIXELS[..., 2::-1])


@pytest.mark.parametrize("seed", range(100))
def test_a_damaged_file_is_judged_the_same_whoever_decodes_it(seed):
    rng = np.random.default_rng(seed)
    content = bytearray(FILES[PLAIN[seed % len(PLAIN)]])
    for at in rng.integers(len(SIGNATURE), len(content), rng.integers(1, 4)):
        content[at] ^= 1 << rng.integers(8)
    if seed % 5 == 0:  # a hole
        at = int(rng.integers(40, len(content) - 40))
        del content[at : at + int(rng.integers(1, 30))]

    found, expected = decoded(bytes(content), "rgb"), by_opencv(bytes(content), "rgb")

    assert type(found) is type(expected)
    np.testing.assert_array_equal(found, expected)


END = chunk(b"IEND", b"")
BEHIND_THE_PIXELS = {
    "a chunk that has to be known": chunk(b"ABCD", b""),
    "a second header": FILES["rgb"][8:33],
    "pixels that do not fit their checksum": chunk(b"IDAT", b"abc")[:-1] + b"?",
    "no chunk": b"\r\n\x1a\n",
    "a chunk that is too long": b"\x80\0\0\1tEXt",
    "half an end": END[:6],
}


@pytest.mark.parametrize("found", BEHIND_THE_PIXELS.values(), ids=[*BEHIND_THE_PIXELS])
def test_what_is_wrong_behind_the_pixels_is_found_whoever_decodes(found):
    content = FILES["rgb"].removesuffix(END) + found + END

    assert by_opencv(content, "rgb") is None
    assert decoded(content, "rgb") is None


def test_without_imagecodecs_there_is_no_faster_way():
    png_decoder.cache_clear()
    try:
        with patch.dict("sys.modules", imagecodecs=None):
            assert png_decoder() is None
    finally:
        png_decoder.cache_clear()
    assert png_decoder() is not None
