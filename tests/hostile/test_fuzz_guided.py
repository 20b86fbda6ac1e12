"""Fuzzing of every parser of bytes from outside: a result or our own error.

Inputs that reach new lines are kept and changed further. Each try has bounds on work,
processor time and memory, which grow with the size of the input. The run is short by
default; ``FUZZ_EXAMPLES`` makes it long, and ``FUZZ_SEED`` repeats an earlier run.
"""

import json
import os
import random
import struct
import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import pytest

from app.errors import AppError
from app.http.bodies import read_parts
from app.ingest.tar import FrameAssembler, TarLimits, TarStream
from app.settings import Settings
from filter_core.annotation.parsing import parse_annotation, without_key
from filter_core.config.file import load_config
from filter_core.config.filter import FilterConfig
from filter_core.errors import FilterError
from filter_core.evidence.lidar import check_points, read_points
from filter_core.formats.registry import read_source
from filter_core.images.decoding import decode_image
from filter_core.images.header import read_image_header
from filter_core.local import filter_one
from tests.support.folders import write_files
from tests.support.hostile import label_samples as labels
from tests.support.hostile import pixel_samples as pixels
from tests.support.hostile import wire_samples as wire
from tests.support.hostile.guided import Bounds, Fuzzer
from tests.support.hostile.mutations import EXAMPLES

IS_LONG = "FUZZ_EXAMPLES" in os.environ
SEED = int(os.environ.get("FUZZ_SEED", str(random.getrandbits(32) if IS_LONG else 7)))
TRIES = (10 if IS_LONG else 5) * EXAMPLES
OWN_CODE = ("/app/", "/filter_core/")
ARCHIVE = TarLimits(max_archive_bytes=10**7, max_member_bytes=50_000, max_members=99)
FRAME = Settings(max_parts=16, max_part_bytes=50_000, max_body_bytes=90_000)
FORM = {"max_parts": 16, "max_part_bytes": 50_000}


def read_archive(content: bytes) -> None:
    stream, frames = TarStream(ARCHIVE), FrameAssembler(FRAME)
    for start in range(0, len(content), 700):
        for name, file in stream.feed(content[start : start + 700]):
            list(frames.add(name, file))
    stream.close()


def read_form(content: bytes) -> None:
    """Read a form; the first line of the content is its media type."""
    media_type, _, body = content.partition(b"\n")

    async def stream():
        for start in range(0, len(body), 700):
            yield body[start : start + 700]

    # It never waits, so that one step runs all of it, without an event loop.
    with suppress(StopIteration):
        read_parts(media_type.decode("latin-1"), stream(), **FORM).send(None)
        raise AssertionError("it waits for something")


def read_image(content: bytes) -> None:
    header = read_image_header(content, max_side=256)
    assert max(header.wh) <= 256
    pixels_decoded = decode_image(content, header, cv2.IMREAD_UNCHANGED)
    assert pixels_decoded is None or pixels_decoded.shape[1::-1] == header.wh


def read_cloud(content: bytes) -> None:
    """Check a point cloud as an upload is checked, then read its points."""
    check_points(content, sensor="radar", max_points=100_000)
    check_points(content, sensor="lidar", max_points=100_000)
    read_points(content, max_points=100_000)


def read_annotation(content: bytes) -> None:
    name, rest = without_key(content, "a")
    parse_annotation(rest, frame=name)


def read_voc(content: bytes) -> None:
    files = dict(labels.FOLDERS["voc"])
    name = next(name for name in sorted(files) if name.endswith(".xml"))
    with TemporaryDirectory() as place:
        folder = write_files(Path(place), {**files, name: content})
        for source in read_source(folder, "voc"):
            filter_one(source, FilterConfig())


def repair_tar_checksums(content: bytes) -> bytes:
    """The archive with the right checksum in each of its headers."""
    blocks = bytearray(content)
    for at in range(0, len(blocks) - 511, 512):
        if blocks[at + 257 : at + 262] == b"ustar":
            total = sum(blocks[at : at + 148]) + 256 + sum(blocks[at + 156 : at + 512])
            blocks[at + 148 : at + 156] = b"%06o\0 " % total
    return bytes(blocks)


def repair_png_crcs(content: bytes) -> bytes:
    """The PNG with the right checksum in each of its complete chunks."""
    png, at = bytearray(content), 8
    while at + 12 <= len(png):
        (length,) = struct.unpack_from(">I", png, at)
        end = at + 8 + length
        if end + 4 > len(png):
            break
        png[end : end + 4] = struct.pack(">I", zlib.crc32(png[at + 4 : end]))
        at = end + 4
    return bytes(png)


@dataclass(frozen=True)
class FuzzTarget:
    """A parser, the samples that it is given first, and its bounds."""

    read: Callable[[bytes], object]
    samples: list[bytes]
    bounds: Bounds = field(default_factory=Bounds)
    folders: tuple[str, ...] = OWN_CODE
    repair: Callable[[bytes], bytes] | None = None
    share: float = 1.0
    """Which share of the tries this parser gets: some are slow."""


PNGS = [content for content in pixels.IMAGES if content.startswith(b"\x89PNG")]
JPEGS = [content for content in pixels.IMAGES if content.startswith(b"\xff\xd8")]
NPYS = [content for content in pixels.CLOUDS if content.startswith(b"\x93")]
PLYS = [content for content in pixels.CLOUDS if content.startswith(b"ply")]
TARGETS = {
    "tar": FuzzTarget(read_archive, wire.ARCHIVES, repair=repair_tar_checksums),
    "multipart": FuzzTarget(
        read_form,
        [wire.MEDIA_TYPE.encode() + b"\n" + wire.FORM],
        folders=(*OWN_CODE, "/python_multipart/"),
    ),
    "png": FuzzTarget(read_image, PNGS, repair=repair_png_crcs),
    "jpeg": FuzzTarget(read_image, JPEGS),
    "npy": FuzzTarget(read_cloud, NPYS),
    "ply": FuzzTarget(read_cloud, PLYS),
    "json": FuzzTarget(read_annotation, [json.dumps(labels.ANNOTATION).encode()]),
    "yaml": FuzzTarget(
        load_config,
        [labels.YAML.encode(), labels.CARLASIMU.encode()],
        folders=(*OWN_CODE, "/yaml/"),
        bounds=Bounds(lines_per_byte=1000, seconds=30),
        share=0.2,
    ),
    "xml": FuzzTarget(
        read_voc,
        [
            content
            for name, content in labels.FOLDERS["voc"].items()
            if name.endswith(".xml")
        ],
        share=0.3,
    ),
}


@pytest.mark.timeout(0 if IS_LONG else 120)
@pytest.mark.parametrize("name", TARGETS)
def test_fuzzed_bytes_give_a_result_or_our_own_error_within_bounds(name):
    target = TARGETS[name]
    fuzzer = Fuzzer(
        read=target.read,
        errors=(AppError, FilterError),
        folders=target.folders,
        bounds=target.bounds,
        repair=target.repair,
    )

    fuzzer.run(target.samples, max(10, int(TRIES * target.share)), SEED)

    assert len(fuzzer.corpus) > len(target.samples)
