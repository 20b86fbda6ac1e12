"""Reading an image's header, and refusing bad files, before anything is decoded."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from filter_core.errors import ImageError, ImageSizeMismatch, ImageTooLarge
from filter_core.images.header import (
    ImageHeader,
    read_image_header,
    read_image_size,
    require_size,
)
from tests.support.pictures import (
    chunk,
    indexed_png,
    jpeg,
    png,
    png_of_chunks,
    with_alpha,
)

GREY = np.zeros((3, 5), np.uint8)
RGB = np.zeros((3, 5, 3), np.uint8)
PIXELS = chunk(b"IDAT", b"")
HEADER = (5, 3, 8, 2)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        pytest.param(png(GREY), ("image/png", 5, 3, 8, "grey"), id="grey PNG"),
        pytest.param(png(RGB), ("image/png", 5, 3, 8, "rgb"), id="RGB PNG"),
        pytest.param(png(with_alpha(RGB)), ("image/png", 5, 3, 8, "rgba"),
         id="RGBA PNG"),
        pytest.param(png(GREY.astype(np.uint16)), ("image/png", 5, 3, 16, "grey"),
         id="16-bit PNG"),
        pytest.param(indexed_png(GREY, np.zeros((1, 3))),
         ("image/png", 5, 3, 8, "indexed"), id="indexed PNG"),
        pytest.param(jpeg(RGB), ("image/jpeg", 5, 3, 8, "rgb"), id="JPEG"),
        pytest.param(cv2.imencode(".jpg", GREY)[1].tobytes(),
         ("image/jpeg", 5, 3, 8, "grey"), id="grey JPEG"),
    ],
)  # fmt: skip
def test_image_header_is_read_from_png_and_jpeg(content, expected):
    assert read_image_header(content) == ImageHeader(*expected)


INVALID_IMAGES = {
    "nothing": (b"", "found no bytes"),
    "a GIF": (b"GIF89a....", "neither|expected a PNG or JPEG"),
    "a web page": (b"<html><body>", "begin with b'<html><b'"),
    "PNG without its last byte": (png(RGB)[:-1], "ends too early"),
    "PNG cut inside its pixels": (png(RGB)[:40], "ends too early"),
    "PNG of a signature alone": (png(RGB)[:8], "ends too early"),
    "JPEG without its end": (jpeg(RGB)[:-2], "ends too early"),
    "JPEG cut": (jpeg(RGB)[:30] + b"\xff\xd9", "ends too early"),
    "JPEG without a frame": (b"\xff\xd8\xff\xd9", "no header"),
    "animated PNG": (
        png_of_chunks(HEADER, chunk(b"acTL", bytes(8)), PIXELS),
        "animated",
    ),
    "PNG without pixels": (png_of_chunks(HEADER), "no pixels"),
    "PNG of no kind": (png_of_chunks((5, 3, 8, 1), PIXELS), "colour type 1"),
    "PNG of 7 bits": (png_of_chunks((5, 3, 7, 2), PIXELS), "bit depth 7"),
    "indexed, 16": (png_of_chunks((5, 3, 16, 3), PIXELS), "type 3 with bit depth 16"),
    "RGB of 4 bits": (png_of_chunks((5, 3, 4, 2), PIXELS), "type 2 with bit depth 4"),
    "no palette": (png_of_chunks((5, 3, 8, 3), PIXELS), "expected a palette"),
    "PNG without width": (png_of_chunks((0, 3, 8, 2), PIXELS), "0 x 3 pixels"),
    "PNG without a header": (
        b"\x89PNG\r\n\x1a\n" + chunk(b"tEXt", b"x" * 20) + chunk(b"IEND"),
        "header of 13 bytes first",
    ),
}


@pytest.mark.parametrize(
    ("content", "message"), INVALID_IMAGES.values(), ids=INVALID_IMAGES
)
def test_invalid_or_truncated_image_is_refused(content, message):
    with pytest.raises(ImageError, match=message):
        read_image_header(content)


@pytest.mark.parametrize(
    ("content", "options", "words"),
    [
        (png_of_chunks((70_000, 4, 8, 6), PIXELS), {}, "70000 x 4 pixels"),
        (png_of_chunks((2**31 - 1, 4, 8, 6), PIXELS), {}, "2147483647 x 4 pixels"),
        (png(RGB), {"max_side": 4}, "5 x 3 pixels, no side may exceed 4"),
    ],
)
def test_oversized_image_is_refused_by_its_header(content, options, words):
    with pytest.raises(ImageTooLarge, match=words):
        read_image_header(content, **options)


@pytest.mark.parametrize(
    ("wh", "words"),
    [
        ((1280, 720), "^the segmentation is 5 x 3 pixels, the image is 1280 x 720$"),
        ((3, 5), "EXIF names is not applied"),
    ],
)
def test_size_mismatch_error_states_both_sizes_and_a_turn(wh, words):
    header = read_image_header(png(RGB))

    with pytest.raises(ImageSizeMismatch, match=words):
        require_size(header, wh, what="the segmentation", than="the image")


def segment(marker, body=b""):
    return bytes([0xFF, marker]) + struct.pack(">H", len(body) + 2) + body


def frame(marker=0xC0, wh=(5, 3), channels=3, depth=8):
    """A JPEG's frame header (SOF)."""
    size = struct.pack(">BHHB", depth, wh[1], wh[0], channels)
    return segment(marker, size + b"\x01\x11\x00" * channels)


def scan(channels=3, data=b"\x12\x34"):
    body = bytes([channels]) + b"\x01\x00" * channels + bytes(3)
    return segment(0xDA, body) + data


SOI, EOI = b"\xff\xd8", b"\xff\xd9"
NOTE = segment(0xFE, b"a note")


def test_jpeg_with_a_hidden_larger_image_is_refused():
    """0xFF 0x00 is no marker: libjpeg searches on, inside what looks like a segment."""
    hidden = cv2.imencode(".jpg", np.zeros((1000, 1000, 3), np.uint8))[1].tobytes()
    start, pixels = hidden.index(b"\xff\xdb"), hidden.index(b"\xff\xda")
    inner = hidden[start : pixels + 20]
    shown = jpeg(np.zeros((48, 64, 3), np.uint8))
    trick = SOI + b"\xff\x00" + struct.pack(">H", len(inner) + 2) + inner + shown[2:]

    decoded = cv2.imdecode(np.frombuffer(trick, np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    assert decoded.shape == (1000, 1000, 3)
    with pytest.raises(ImageError, match="found the bytes FF 00 at byte 2"):
        read_image_header(trick)


UNUSUAL_JPEGS = {
    "a byte between": (SOI + frame() + b"\0" + scan() + EOI, "expected a marker"),
    "SOI again": (SOI + NOTE + SOI + frame() + scan() + EOI, "within"),
    "SOF again": (SOI + frame() + frame() + scan() + EOI, "another"),
    "SOF behind a scan": (SOI + frame() + scan() + frame() + EOI, "another"),
    "SOS before SOF": (SOI + scan() + frame() + EOI, "before the pixels"),
    "no scan": (SOI + frame() + EOI, "no pixels"),
    "lossless": (SOI + frame(0xC3) + scan() + EOI, "lossless"),
    "hierarchical": (SOI + frame(0xC5) + scan() + EOI, "hierarchical"),
    "arithmetic": (SOI + frame(0xC9) + scan() + EOI, "arithmetic"),
    "DNL": (
        SOI + frame() + scan() + segment(0xDC, b"\0\x09") + EOI,
        "a height that follows",
    ),
    "DHP": (SOI + segment(0xDE, bytes(17)) + EOI, "hierarchical"),
    "RST astray": (SOI + b"\xff\xd0" + frame() + EOI, "FF D0"),
    "TEM": (SOI + b"\xff\x01" + frame() + EOI, "FF 01"),
    "JPEG-LS": (SOI + segment(0xF7) + EOI, "FF F7"),
    "reserved": (SOI + segment(0x02) + EOI, "FF 02"),
    "12 bits": (SOI + frame(depth=12) + scan() + EOI, "8 bits"),
    "two channels": (SOI + frame(channels=2) + EOI, "1, 3 or 4"),
    "a scan of others": (SOI + frame(channels=1) + scan(3) + EOI, "a scan of 3"),
    "a short SOF": (
        SOI + segment(0xC0, b"\x08\0\x03\0\x05\x03" + bytes(6)) + scan() + EOI,
        "has 15 bytes",
    ),
    "scans again": (SOI + frame() + scan() * 4 + EOI, "at most 3 scans"),
    "many scans": (SOI + frame(0xC2) + scan() * 3000 + EOI, "at most 32 scans"),
    "many notes": (SOI + NOTE * 2000 + frame() + EOI, "1000 segments"),
    "much padding": (SOI + b"\xff" * 99 + EOI, "padding"),
    "no end": (SOI + frame() + scan(), "ends too early"),
    "cut": (SOI + frame() + scan(data=b"\xff\x00\xff\xd0\xff"), "too early"),
}


@pytest.mark.parametrize(
    ("content", "message"), UNUSUAL_JPEGS.values(), ids=UNUSUAL_JPEGS
)
def test_jpeg_with_unusual_structure_is_refused(content, message):
    with pytest.raises(ImageError, match=f"^JPEG: .*{message}"):
        read_image_header(content)


def test_image_in_the_metadata_of_a_jpeg_is_neither_its_end_nor_a_fault():
    content = jpeg(RGB)
    embedded = content[:2] + segment(0xE1, b"Exif\0\0" + content) + content[2:]

    assert read_image_header(embedded + content * 2).wh == (5, 3)
    with pytest.raises(ImageError, match="ends too early"):
        read_image_header(embedded[:-2])
    # Padding before a marker is skipped.
    padded = content[:2] + b"\xff\xff\xff" + content[2:]

    assert read_image_header(padded) == read_image_header(content)


@pytest.mark.parametrize("offset", [-2, -1, 0, 1])
def test_jpeg_end_marker_across_a_search_boundary_is_found(offset):
    head = SOI + frame() + scan(data=b"")
    data = bytes((1 << 20) + offset)

    assert read_image_header(head + data + EOI).wh == (5, 3)


@pytest.mark.parametrize("progressive", [0, 1])
@pytest.mark.parametrize("restarts", [0, 1, 5])
@pytest.mark.parametrize("sampling", [0x411111, 0x221111, 0x111111, 0x121111])
@pytest.mark.parametrize("wh", [(1, 1), (17, 33), (640, 48)])
def test_headers_of_common_encoders_are_read(progressive, restarts, sampling, wh):
    noise = np.random.default_rng(7).integers(0, 256, (wh[1], wh[0], 3), np.uint8)
    flags = {
        cv2.IMWRITE_JPEG_PROGRESSIVE: progressive,
        cv2.IMWRITE_JPEG_OPTIMIZE: progressive,
        cv2.IMWRITE_JPEG_RST_INTERVAL: restarts,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR: sampling,
    }
    options = [number for pair in flags.items() for number in pair]

    for picture in (noise, noise // 200, noise[:, :, 0]):
        content = cv2.imencode(".jpg", picture, options)[1].tobytes()
        assert read_image_header(content).wh == wh


def text_chunk(size, kind=b"zTXt"):
    packed = zlib.compress(bytes(size), 9)
    heads = {b"zTXt": b"k\0\0", b"iCCP": b"k\0\0", b"iTXt": b"k\0\1\0en\0k\0"}
    return chunk(kind, heads[kind] + packed)


VALID_PIXELS = chunk(b"IDAT", zlib.compress(b"\0" * (3 * 16)))
NOTE_CHUNK = chunk(b"tEXt", b"k\0v")


UNUSUAL_CHUNKS = {
    "IHDR again": ([chunk(b"IHDR", bytes(13)), VALID_PIXELS], "one header"),
    "critical, unknown": ([chunk(b"QRST"), VALID_PIXELS], "b'QRST'"),
    "a name of no letters": ([chunk(b"a\xffst"), VALID_PIXELS], "not be ignored"),
    "PLTE too late": ([VALID_PIXELS, chunk(b"PLTE", bytes(3))], "before the pixels"),
    "odd PLTE": ([chunk(b"PLTE", bytes(4)), VALID_PIXELS], "1 to 256 col"),
    "CRC": ([chunk(b"PLTE", bytes(3))[:-1] + b"x", VALID_PIXELS], "checksum"),
    "apart": ([VALID_PIXELS, NOTE_CHUNK, VALID_PIXELS], "between the chunks of pixels"),
    "animated later": ([VALID_PIXELS, chunk(b"fcTL", bytes(26))], "animated"),
    "notes": ([NOTE_CHUNK] * 501 + [VALID_PIXELS], "500 ch"),
    "bytes": ([chunk(b"tEXt", bytes(1 << 20))] * 17 + [VALID_PIXELS], "bytes besides"),
    "inflated behind": ([VALID_PIXELS, text_chunk(5_000_000)], "inflate"),
    "many parts": ([chunk(b"IDAT", b"")] * 2000, "parts"),
    "IEND that is long": ([chunk(b"IEND", b"x")], "end has 1 bytes"),
}
for kind in (b"zTXt", b"iTXt", b"iCCP"):
    many = [text_chunk(9, kind)] * 17 + [VALID_PIXELS]
    large = [text_chunk(2_500_000, kind)] * 2 + [VALID_PIXELS]
    UNUSUAL_CHUNKS[f"many {kind.decode()}"] = (many, "16 compr")
    UNUSUAL_CHUNKS[f"large {kind.decode()}"] = (large, "inflate")


@pytest.mark.parametrize(
    ("chunks", "message"), UNUSUAL_CHUNKS.values(), ids=UNUSUAL_CHUNKS
)
def test_png_with_unusual_chunks_is_refused(chunks, message):
    with pytest.raises(ImageError, match=message):
        read_image_header(png_of_chunks(HEADER, *chunks))


def test_metadata_beside_the_pixels_is_accepted():
    notes = [NOTE_CHUNK] * 60 + [text_chunk(300_000)] * 10
    profile = text_chunk(500_000, b"iCCP")
    content = png_of_chunks(
        HEADER, profile, *notes, VALID_PIXELS, VALID_PIXELS, *notes[:2]
    )

    assert read_image_header(content).wh == (5, 3)


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("tail", [bytes(4088), bytes(100_000), chunk(b"IDAT") * 1000])
def test_bytes_after_the_end_of_a_png_are_ignored(tail, whole):
    content = png_of_chunks(HEADER, VALID_PIXELS)

    assert read_image_header(content + tail, whole=whole).wh == (5, 3)
    with pytest.raises(ImageError):  # zeros without an end before them
        read_image_header(content[:-12] + bytes(5000), whole=whole)


def test_partial_check_accepts_faults_in_the_middle_of_a_file():
    damaged = png_of_chunks(HEADER, VALID_PIXELS, chunk(b"tEXt"), VALID_PIXELS)
    scans = SOI + frame() + scan() * 9 + EOI

    for content in (damaged, scans):
        assert read_image_header(content, whole=False).wh == (5, 3)
        with pytest.raises(ImageError):
            read_image_header(content)


@pytest.mark.parametrize(
    ("start", "wh"),
    [
        pytest.param(png(RGB)[:24], (5, 3), id="PNG"),
        pytest.param(png(RGB), (5, 3), id="whole PNG"),
        pytest.param(jpeg(RGB)[:-2], (5, 3), id="JPEG without its end"),
    ],
)
def test_image_size_is_read_from_the_first_bytes(start, wh):
    assert read_image_size(start) == wh


WITHOUT_SIZE = {
    "PNG of 23 bytes": (png(RGB)[:23], "ends too early"),
    "no header": (png(RGB)[:12] + b"IDAT" + png(RGB)[16:], "no header"),
    "JPEG of 30 bytes": (jpeg(RGB)[:30], "ends too early"),
    "nothing": (b"", "no bytes"),
    "no width": (png(RGB)[:16] + struct.pack(">II", 0, 3), "0 x 3 pixels"),
    "too high": (png(RGB)[:16] + struct.pack(">II", 5, 1 << 30), "no side"),
}


@pytest.mark.parametrize(("start", "message"), WITHOUT_SIZE.values(), ids=WITHOUT_SIZE)
def test_first_bytes_without_a_valid_size_are_refused(start, message):
    with pytest.raises(ImageError, match=message):
        read_image_size(start)
