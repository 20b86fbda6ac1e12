"""Checks an uploaded frame: its key, its annotation and the headers of its files."""

from __future__ import annotations

import hashlib
import json
import unicodedata
from collections.abc import Mapping
from typing import Final, get_args

from app.boxes.queries import FileRow
from app.errors import Unprocessable
from app.incoming import in_turn, is_large
from app.ingest.frame import UploadedFrame
from app.settings import Settings
from app.storage.base import sha256_of
from filter_core.annotation.frame import AnnotationLimits, FrameAnnotation
from filter_core.annotation.parsing import parse_annotation, without_key
from filter_core.errors import ImageError, ImageTooLarge, error_context, file_context
from filter_core.evidence.lidar import check_points
from filter_core.formats.reading import MAX_KEY
from filter_core.images.header import read_image_header, require_size
from unghost.wire.words import FileKind

KINDS: Final = get_args(FileKind)
CLOUDS: Final = ("lidar", "radar")
PICTURES: Final = tuple(kind for kind in KINDS if kind not in CLOUDS)
_GIVES_SIZE: Final = ("image", "segmentation", "instances")
"""The first of these pictures that a frame has gives the size of its image."""
_OF_THIS_SIZE: Final = ("segmentation", "ignore_mask")
"""The pictures that must have this size."""

MAX_TEXT: Final = 200
"""Maximum length of an id, a class or a map, as in their columns."""
_CANONICAL: Final = json.JSONEncoder(sort_keys=True, separators=(",", ":"))
_DIGEST_OF: Final = b"frame 1\n"
"""Prefix of the data of every content digest: a version of its definition."""


def check_frame(
    key: str,
    annotation: bytes | Mapping[str, object],
    upload: UploadedFrame,
    settings: Settings,
) -> tuple[FrameAnnotation, tuple[int, int], tuple[FileRow, ...], str]:
    """Read the annotation and the headers of the files; nothing is decoded.

    `key` and `annotation` come from `read_key`. Returns the annotation, (width, height)
    of the image in px, a row for each file, and the digest of all of it. Raises
    FilterError: the annotation or one of the files is invalid.
    """
    size = len(upload.annotation)
    limits = _annotation_limits(settings)
    with in_turn(size):
        parsed = parse_annotation(annotation, limits=limits, frame=key)
    with error_context(key):
        wh, files = check_files(upload.files, parsed, settings)
    with in_turn(size):
        digest = hashlib.sha256(_DIGEST_OF)
        for file in files:
            digest.update(f"{file.kind} {file.sha256}\n".encode())
        if is_large(size):
            # In pieces: no other thread runs while a document is written as a whole.
            for piece in _CANONICAL.iterencode(parsed.raw):
                digest.update(piece.encode())
        else:
            digest.update(_CANONICAL.encode(parsed.raw).encode())
    return parsed, wh, files, digest.hexdigest()


def read_key(
    upload: UploadedFrame, settings: Settings
) -> tuple[str, bytes | Mapping[str, object]]:
    """The frame's key, and its annotation without the key.

    Raises AppError: the fault that was found while the frame was received;
    AnnotationErrors: the annotation, which may contain the key, is not JSON.
    """
    if upload.fault is not None:
        raise upload.fault
    if not upload.may_rename:
        return upload.key, upload.annotation
    with in_turn(len(upload.annotation)):
        return without_key(upload.annotation, upload.key, _annotation_limits(settings))


def _annotation_limits(settings: Settings) -> AnnotationLimits:
    return AnnotationLimits(
        max_boxes=settings.max_boxes_per_frame,
        max_text=MAX_TEXT,
        max_bytes=int(settings.max_json_bytes),
    )


def check_files(
    contents: Mapping[str, bytes], annotation: FrameAnnotation, settings: Settings
) -> tuple[tuple[int, int], tuple[FileRow, ...]]:
    """Check types and sizes, and that files are complete; reads no pixel or point.

    Returns (width, height) of the image in px, and a row for each file.

    Raises PointsError: a file is not a point cloud, or not as long as its header says;
    ImageError: a file is not an image, is too large, or has another size than the RGB
    image; ``unknown_size``: neither a picture nor the camera gives the size of the
    image.
    """
    headers = {}
    for kind in PICTURES:
        if kind in contents:
            with file_context(kind):
                header = read_image_header(
                    contents[kind], max_side=settings.max_image_side_px
                )
            if header.width * header.height > settings.max_image_pixels:
                raise ImageTooLarge(
                    f"{kind}: expected at most {settings.max_image_pixels} pixels, "
                    f"found {header.width} x {header.height}",
                    pointer=f"/{kind}",
                )
            headers[kind] = header
    types = {kind: header.media_type for kind, header in headers.items()}
    types |= {
        kind: check_points(contents[kind], sensor=kind)
        for kind in CLOUDS
        if kind in contents
    }
    sized = [headers[kind].wh for kind in _GIVES_SIZE if kind in headers]
    wh = sized[0] if sized else annotation.camera_wh
    if wh is None:
        raise ImageError(
            "the size of the image is not known: expected an image, a segmentation, an "
            "instance image, or a camera with width and height, found none of them",
            code="unknown_size",
        )
    for kind in _OF_THIS_SIZE:
        if kind in headers:
            with error_context(pointer=f"/{kind}"):
                require_size(headers[kind], wh, what=f"the {kind}", than="the image")
    rows = tuple(
        FileRow(kind, sha256_of(content), len(content), types[kind])
        for kind, content in sorted(contents.items())
    )
    return wh, rows


def require_key(key: str) -> None:
    """Refuse a key that cannot name a frame.

    Raises Unprocessable: ``bad_key``: it is empty, too long, has control characters, or
    has parts that lead out of a folder in a file system.
    """
    parts = key.split("/")
    if not key or len(key) > MAX_KEY:
        fault = f"{len(key)} characters"
    elif any(unicodedata.category(character).startswith("C") for character in key):
        fault = "a control character"
    elif "\N{REPLACEMENT CHARACTER}" in key:
        # From a URL that is not UTF-8: different keys would become the same.
        fault = "a character that could not be read as UTF-8"
    elif "" in parts:
        fault = "an empty part between slashes"
    elif any(part in (".", "..") for part in parts) or "\\" in key:
        fault = "a part that leads out of a folder"
    else:
        return
    raise Unprocessable(
        f"key {key[:80]!r}: expected 1 to {MAX_KEY} characters such as "
        f"'town10/000012', found {fault}",
        code="bad_key",
    )
