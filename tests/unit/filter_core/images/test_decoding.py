"""Colour images: the fast way of decoding gives the pixels and faults of OpenCV."""

import re
import struct
import zlib
from contextlib import contextmanager
from unittest.mock import patch

import cv2
import numpy as np
import pytest

from filter_core.errors import ImageError
from filter_core.images.decoding import decode_as_seen, decode_color, decode_image
from filter_core.images.header import read_image_header
from filter_core.images.png import PngHeader
from tests.support import pictures
from tests.support.pictures import chunk

FLAGS = {"rgb": cv2.IMREAD_COLOR_RGB, "bgr": cv2.IMREAD_COLOR}
SIGNATURE = b"\x89PNG\r\n\x1a\n"
WIDTH, HEIGHT = 37, 23
RGB, RGBA, INDEXED, GREY = 2, 6, 3, 0
RNG = np.random.default_rng(2026)
PIXELS = RNG.integers(0, 256, (HEIGHT, WIDTH, 4), np.uint8)
STREET = RNG.integers(0, 256, (300, 400, 3), np.uint8)
PASSES = [(0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4)]
PASSES += [(2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1)]
"""First row and column, and steps in both, of each pass of an interlaced PNG."""


def rows(pixels: np.ndarray, filters=b"\0") -> bytes:
    """Pixels as the filtered rows of a PNG; `filters` (0, 1 or 2) are used in turns."""
    zeros = np.zeros_like(pixels)
    left, above = zeros.copy(), zeros.copy()
    left[:, 1:], above[1:] = pixels[:, :-1], pixels[:-1]
    stored = [pixels - predicted for predicted in (zeros, left, above)]
    turns = [filters[row % len(filters)] for row in range(len(pixels))]
    return b"".join(
        bytes([turn]) + stored[turn][row].tobytes() for row, turn in enumerate(turns)
    )


def png(pixels, color_type, *extra: bytes, depth=8, interlaced=False) -> bytes:
    raw = rows(pixels)
    if interlaced:
        raw = b"".join(rows(pixels[y::dy, x::dx]) for y, x, dy, dx in PASSES)
    form = bytes([depth, color_type, 0, 0, interlaced])
    return framed(pixels, form, zlib.compress(raw), extra=extra)


def framed(pixels, form: bytes, *bodies: bytes, extra: tuple[bytes, ...] = ()) -> bytes:
    height, width = pixels.shape[:2]
    head = chunk(b"IHDR", struct.pack(">II", width, height) + form)
    parts = [head, *extra, *(chunk(b"IDAT", body) for body in bodies)]
    return SIGNATURE + b"".join(parts) + chunk(b"IEND", b"")


def filtered(pixels, filters, pieces=1, kept=slice(None)) -> bytes:
    """A PNG with these filters, its data in `pieces` chunks, and `kept` of its rows."""
    body = zlib.compress(rows(pixels, filters)[kept])
    size = -(-len(body) // pieces)
    bodies = [body[start : start + size] for start in range(0, len(body), size)]
    return framed(pixels, bytes([8, RGB, 0, 0, 0]), *bodies)


def encoded(pixels, *flags) -> bytes:
    return cv2.imencode(".png", pixels, flags)[1].tobytes()


COLORS = PIXELS[..., :3]
WHOLE = png(COLORS, RGB)
TRANSPARENT = chunk(b"tRNS", struct.pack(">3H", *PIXELS[0, 0, :3]))
GAMMA = chunk(b"gAMA", struct.pack(">I", 100_000))
ANIMATION = chunk(b"acTL", bytes(8)) + chunk(b"IDAT", b"no pixels")
ALL_FILTERS = (cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_ALL_FILTERS)
FILES = {
    "rgb": WHOLE,
    "rgba": png(PIXELS, RGBA),
    "rgb with a transparent colour": png(COLORS, RGB, TRANSPARENT),
    "rgb with a gamma": png(COLORS, RGB, GAMMA),
    "rgb with fewer significant bits": png(COLORS, RGB, chunk(b"sBIT", b"\5\6\5")),
    "interlaced": png(COLORS, RGB, interlaced=True),
    "16 bits": png(COLORS.astype(">u2") * 257, RGB, depth=16),
    "indexed": png(PIXELS[..., 0], INDEXED, chunk(b"PLTE", bytes(range(256)) * 3)),
    "grey": png(PIXELS[..., 0], GREY),
    "followed by notes": WHOLE + b"notes of an editor",
    "followed by much": WHOLE + bytes(50_000),
    "followed by another picture": WHOLE + png(COLORS[::-1], RGB),
    "by opencv, followed by another": encoded(COLORS) + encoded(COLORS[::-1]),
    "followed by an animation's chunks": WHOLE + ANIMATION + chunk(b"IEND", b""),
    "jpeg": cv2.imencode(".jpg", COLORS)[1].tobytes(),
    "by opencv": encoded(np.sort(PIXELS, 1)[..., :3]),
    "by opencv with alpha": encoded(PIXELS),
    "differences, in pieces": filtered(COLORS, b"\1", pieces=5),
    "some differences": filtered(COLORS, b"\0\1\1"),
    "rows above": filtered(COLORS, b"\1\2"),
    "rows above, in many blocks": filtered(STREET, b"\1\2"),
    "rows above, in full blocks": filtered(STREET[:, :, :1].repeat(3, 2), b"\2"),
    "every filter": encoded(np.sort(PIXELS, 1)[..., :3], *ALL_FILTERS),
}
IN_STEPS = [
    *("rgb", "rgba", "by opencv", "by opencv with alpha"),
    *("differences, in pieces", "some differences"),
]
BY_OPENCV = [
    *("rgb with a gamma", "rgb with fewer significant bits", "every filter"),
    *("rows above", "rows above, in many blocks", "rows above, in full blocks"),
]
PLAIN = IN_STEPS + BY_OPENCV


def decoded(content, order):
    try:
        return decode_color(content, read_image_header(content), order)
    except ImageError as error:
        return str(error)


def by_opencv(content, order):
    try:
        return decode_image(content, read_image_header(content), FLAGS[order])
    except ImageError as error:
        return str(error)


@pytest.mark.parametrize("order", ["rgb", "bgr"])
@pytest.mark.parametrize("content", FILES.values(), ids=list(FILES))
def test_decode_color_gives_the_same_pixels_as_opencv(content, order):
    pixels = decoded(content, order)

    assert pixels.shape[2] == 3
    assert pixels.dtype == np.uint8
    assert pixels.flags.c_contiguous
    np.testing.assert_array_equal(pixels, by_opencv(content, order))


@contextmanager
def record_opencv_input():
    """Collect the files that OpenCV is given to decode."""
    contents = list[bytes]()

    def decode(content, flags):
        contents.append(bytes(content))
        return imdecode(content, flags)

    imdecode = cv2.imdecode
    with patch.object(cv2, "imdecode", decode):
        yield contents


@pytest.mark.parametrize("name", PLAIN)
def test_common_png_files_use_the_fast_decoder(name):
    with record_opencv_input() as contents:
        decoded(FILES[name], "rgb")

    # OpenCV gets uncompressed data: after zlib's header, stored blocks.
    stored = [re.search(rb"IDAT\x78\x01[\0\1]", content) for content in contents]
    assert [bool(match) for match in stored] == ([] if name in IN_STEPS else [True])


def test_very_large_image_is_decoded_only_by_opencv():
    small, large = (encoded(np.zeros((n, n, 3), np.uint8)) for n in (100, 5000))

    with record_opencv_input() as contents:
        shapes = [decoded(content, "rgb").shape for content in (small, large)]

    assert shapes == [(100, 100, 3), (5000, 5000, 3)]
    assert contents == [large]


def check_like_opencv(content):
    pixels, expected = decoded(content, "rgb"), by_opencv(content, "rgb")

    assert type(pixels) is type(expected)
    np.testing.assert_array_equal(pixels, expected)


@pytest.mark.parametrize("seed", range(9 * 16))
def test_damaged_file_gives_the_same_result_as_opencv(seed):
    rng = np.random.default_rng(seed)
    content = bytearray(FILES[PLAIN[seed % len(PLAIN)]])
    for at in rng.integers(len(SIGNATURE), len(content), rng.integers(1, 4)):
        content[at] ^= 1 << rng.integers(8)
    if seed % 5 == 0:  # a hole
        at = int(rng.integers(40, len(content) - 40))
        del content[at : at + int(rng.integers(1, 30))]

    check_like_opencv(bytes(content))


BODY = zlib.compress(rows(PIXELS[..., :3], b"\1"))
FORM = bytes([8, RGB, 0, 0, 0])
LARGER = struct.pack(">IIIIIHHBB", 0, WIDTH + 1, HEIGHT, 0, 0, 1, 10, 0, 0)
WRONG_FILTER = zlib.compress(rows(COLORS).replace(b"\0", b"\5", 1))
NO_SUM = FILES["by opencv"][:29] + b"1234" + FILES["by opencv"][33:]
MORE = chunk(b"tEXt", b"a\0b") + chunk(b"IDAT", BODY[900:]) + chunk(b"IEND", b"")
MALFORMED = {
    "half a row too few": filtered(COLORS, b"\1", kept=slice(None, -50)),
    "a row too many": framed(PIXELS[:-1, :, :3], FORM, BODY),
    "a wrong sum behind": framed(PIXELS, FORM, BODY[:-1] + bytes([BODY[-1] ^ 1])),
    "something behind the sum": framed(PIXELS, FORM, BODY + b"more"),
    "no such filter": framed(PIXELS, FORM, WRONG_FILTER),
    "no sum of the header": NO_SUM,
    "no pixels": framed(PIXELS, FORM),
    "a frame of an animation, which is larger": framed(
        PIXELS, FORM, BODY, extra=(chunk(b"fcTL", LARGER),)
    ),
    "no compression known": framed(PIXELS, bytes([8, RGB, 1, 0, 0]), BODY),
    "no filters known": framed(PIXELS, bytes([8, RGB, 0, 1, 0]), BODY),
    "other chunks between": framed(PIXELS, FORM, BODY[:900]).replace(
        chunk(b"IEND", b""), MORE
    ),
}


@pytest.mark.parametrize("content", MALFORMED.values(), ids=list(MALFORMED))
def test_malformed_png_gives_the_same_result_as_opencv(content):
    check_like_opencv(content)


END = chunk(b"IEND", b"")
AFTER_THE_PIXELS = {
    "a chunk that has to be known": chunk(b"ABCD", b""),
    "a second header": FILES["rgb"][8:33],
    "pixels that do not fit their checksum": chunk(b"IDAT", b"abc")[:-1] + b"?",
    "no chunk": b"\r\n\x1a\n",
    "a chunk that is too long": b"\x80\0\0\1tEXt",
    "half an end": END[:6],
}


@pytest.mark.parametrize("fault", AFTER_THE_PIXELS.values(), ids=[*AFTER_THE_PIXELS])
def test_fault_after_the_pixels_is_found_by_every_decoder(fault):
    content = FILES["rgb"].removesuffix(END) + fault + END

    assert not isinstance(by_opencv(content, "rgb"), np.ndarray)
    assert not isinstance(decoded(content, "rgb"), np.ndarray)


@pytest.mark.parametrize("reduced", [1, 2, 4, 8])
@pytest.mark.parametrize("wh", [(64, 48), (65, 49), (71, 55)])
@pytest.mark.parametrize("encode", [pictures.png, pictures.jpeg])
def test_reduced_image_has_the_reduced_size_of_its_header(reduced, wh, encode):
    content = encode(np.zeros((wh[1], wh[0], 3), np.uint8))
    flags = 1 if reduced == 1 else 1 | reduced * 8

    pixels = decode_image(content, read_image_header(content), flags)

    assert pixels is not None
    assert abs(pixels.shape[1] - wh[0] / reduced) < 1


@pytest.mark.parametrize("flags", [-1, 0, 1, cv2.IMREAD_REDUCED_COLOR_2])
def test_image_whose_size_differs_from_its_header_is_not_decoded(flags):
    content = pictures.png(np.zeros((48, 64, 3), np.uint8))
    other = read_image_header(pictures.png(np.zeros((48, 68, 3), np.uint8)))

    assert decode_image(content, read_image_header(content), flags) is not None
    assert decode_image(content, other, flags) is None


@pytest.mark.parametrize("flags", [cv2.IMREAD_COLOR, cv2.IMREAD_REDUCED_COLOR_2])
@pytest.mark.parametrize(
    ("orientation", "turned"),
    [
        (1, np.s_[:, :]),
        (2, np.s_[:, ::-1]),
        (3, np.s_[::-1, ::-1]),
        (4, np.s_[::-1]),
        (6, np.s_[:, :]),
    ],
)
def test_picture_is_drawn_as_seen_unless_its_sides_would_be_exchanged(
    flags, orientation, turned
):
    picture = np.zeros((32, 48, 3), np.uint8)
    picture[:16, :24], picture[16:, :24] = 250, 120
    content = pictures.with_orientation(pictures.jpeg(picture), orientation)

    pixels = decode_as_seen(content, read_image_header(content), flags)

    assert pixels is not None
    step = 32 // len(pixels)
    expected = picture[turned][::step, ::step]
    np.testing.assert_allclose(pixels.astype(int), expected, atol=12)


def test_exif_orientation_is_ignored_when_decoding():
    content = pictures.jpeg(np.zeros((3, 5, 3), np.uint8))
    turned = pictures.with_orientation(content, 6)

    by_exif = cv2.imdecode(np.frombuffer(turned, np.uint8), cv2.IMREAD_COLOR)
    assert by_exif is not None
    assert by_exif.shape[:2] == (5, 3)
    pixels = decode_image(turned, read_image_header(turned), cv2.IMREAD_COLOR)

    assert pixels is not None
    assert pixels.shape[:2] == (3, 5)


def with_more_pixels(color_type, depth, interlaced, more, wh=(WIDTH, HEIGHT)):
    """A PNG of zeros that inflates to `more` bytes more than its header says."""
    head = struct.pack(">IIBBBBB", *wh, depth, color_type, 0, 0, interlaced)
    width, height = wh
    header = PngHeader(width, height, depth, color_type, bool(interlaced))
    size = header.inflated_bytes
    body = zlib.compress(bytes(size + more), 9)
    palette = chunk(b"PLTE", bytes(6)) if color_type == INDEXED else b""
    parts = chunk(b"IHDR", head) + palette + chunk(b"IDAT", body) + chunk(b"IEND", b"")
    return SIGNATURE + parts


KINDS = [(GREY, 1), (GREY, 8), (GREY, 16), (RGB, 8), (RGB, 16), (INDEXED, 1)]
KINDS += [(INDEXED, 4), (INDEXED, 8), (4, 8), (4, 16), (RGBA, 8), (RGBA, 16)]


@pytest.mark.parametrize("interlaced", [0, 1])
@pytest.mark.parametrize(("color_type", "depth"), KINDS)
def test_png_that_inflates_beyond_its_header_is_refused(color_type, depth, interlaced):
    """Decoders would also inflate what follows, to a thousand times its size."""
    for wh in ((WIDTH, HEIGHT), (1, 1), (3, 9)):
        whole = with_more_pixels(color_type, depth, interlaced, 0, wh)
        short = with_more_pixels(color_type, depth, interlaced, -1, wh)
        header = read_image_header(whole)
        assert decode_image(whole, header, cv2.IMREAD_UNCHANGED) is not None
        assert decode_image(short, header, cv2.IMREAD_UNCHANGED) is None

        for more in (1, 4_000_000):
            bomb = with_more_pixels(color_type, depth, interlaced, more, wh)
            with pytest.raises(ImageError, match="found more when they were inflated"):
                decode_image(bomb, header, cv2.IMREAD_UNCHANGED)
            with pytest.raises(ImageError, match="found more when they were inflated"):
                decode_color(bomb, header, "rgb")


def test_compressed_pixels_larger_than_uncompressed_are_refused():
    """No encoder writes more than the raw pixels: it is a bomb, or empty blocks."""
    bomb = with_more_pixels(RGB, 8, 0, 200_000_000)

    with pytest.raises(ImageError, match="when they are not compressed"):
        read_image_header(bomb)
