"""What a frame may be called, and which files it may consist of."""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from app.boxes.queries import FileRow
from app.errors import Unprocessable
from app.measuring.pixels import FrameFiles
from app.settings import Settings
from app.storage import sha256_of
from filter_core.annotation.frame import FrameAnnotation
from filter_core.errors import ImageError, ImageSizeMismatch, ImageTooLarge
from filter_core.evidence.lidar import check_points
from filter_core.formats.reading import MAX_KEY
from filter_core.images.header import ImageHeader, read_image_header, require_size

PICTURES: Final = ("image", "segmentation", "depth", "instances", "ignore_mask")
CLOUDS: Final = ("lidar", "radar")
KINDS: Final = (*PICTURES, *CLOUDS)
_SAME_SIZE: Final = ("segmentation", "ignore_mask")


@dataclass(frozen=True)
class CheckedFiles:
    """Files whose headers are in order; their pixels were not looked at."""

    contents: Mapping[str, bytes]
    rows: tuple[FileRow, ...]
    image_wh: tuple[int, int]

    def blobs(self) -> dict[str, bytes]:
        """The files by their digests."""
        return {row.sha256: self.contents[row.kind] for row in self.rows}

    def measured(self, sensors: tuple[str, ...]) -> FrameFiles:
        """What a measurement reads that asks for the files of these sensors."""
        return FrameFiles.of(self.contents, self.image_wh, sensors)


def check_files(
    contents: Mapping[str, bytes], annotation: FrameAnnotation, settings: Settings
) -> CheckedFiles:
    """Check types and sizes, and that files are whole; no pixel and no point is read.

    Raises
    ------
    PointsError
        A point cloud is none, or not as long as its header says.
    ImageError
        A file is no image, is too large, or has another size than the RGB image;
        ``unknown_size``: neither a picture nor the camera says how large the image is.
    """
    headers = {
        kind: _header(kind, contents[kind], settings)
        for kind in PICTURES
        if kind in contents
    }
    types = {kind: header.media_type for kind, header in headers.items()}
    types |= {
        kind: check_points(contents[kind], sensor=kind)
        for kind in CLOUDS
        if kind in contents
    }
    wh = _image_wh(headers, annotation)
    for kind in _SAME_SIZE:
        if kind in headers:
            _require_size(kind, headers[kind], wh)
    rows = tuple(
        FileRow(kind, sha256_of(content), len(content), types[kind])
        for kind, content in sorted(contents.items())
    )
    return CheckedFiles(contents, rows, wh)


def _header(kind: str, content: bytes, settings: Settings) -> ImageHeader:
    try:
        header = read_image_header(content, max_side=settings.max_image_side_px)
    except ImageError as error:
        raise type(error)(f"{kind}: {error.detail}", pointer=f"/{kind}") from error
    if header.width * header.height > settings.max_image_pixels:
        raise ImageTooLarge(
            f"{kind}: expected at most {settings.max_image_pixels} pixels, "
            f"found {header.width} x {header.height}",
            pointer=f"/{kind}",
        )
    return header


def _require_size(kind: str, header: ImageHeader, wh: tuple[int, int]) -> None:
    try:
        require_size(header, wh, what=f"the {kind}", than="the image")
    except ImageSizeMismatch as error:
        raise ImageSizeMismatch(error.detail, pointer=f"/{kind}") from error


def _image_wh(
    headers: Mapping[str, ImageHeader], annotation: FrameAnnotation
) -> tuple[int, int]:
    for kind in ("image", "segmentation"):
        if kind in headers:
            return headers[kind].width, headers[kind].height
    if annotation.camera_wh is not None:
        return annotation.camera_wh
    raise ImageError(
        "the size of the image is not known: expected an image, a segmentation or a "
        "camera with width and height, found none of them",
        code="unknown_size",
    )


def checked_key(key: str) -> str:
    """The key, if it can name a frame.

    Raises
    ------
    Unprocessable
        ``bad_key``: empty, too long, with control characters, or with parts that a
        file system would read as a way out of a folder.
    """
    fault = _fault(key)
    if fault:
        raise Unprocessable(
            f"key {key[:80]!r}: expected 1 to {MAX_KEY} characters such as "
            f"'town10/000012', found {fault}",
            code="bad_key",
        )
    return key


def _fault(key: str) -> str:
    parts = key.split("/")
    if not key or len(key) > MAX_KEY:
        return f"{len(key)} characters"
    if any(unicodedata.category(character).startswith("C") for character in key):
        return "a control character"
    if "\N{REPLACEMENT CHARACTER}" in key:
        # Of an address that is not UTF-8; keys that differ would become the same.
        return "a character that could not be read as UTF-8"
    if "" in parts:
        return "an empty part between slashes"
    if any(part in (".", "..") for part in parts) or "\\" in key:
        return "a part that leads out of a folder"
    return ""
