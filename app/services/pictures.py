"""Pictures drawn from a frame's files: thumbnails, crops and overlays."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from app.errors import NotFound, Unprocessable
from app.repositories.datasets import DatasetRepository
from app.repositories.evidence import EvidenceRepository
from app.repositories.frames import FileRow, FrameRepository
from app.services.drawing import draw_boxes
from app.storage import BlobStore
from filter_core.palettes import FAMILIES
from filter_core.segmentation import SegmentationOptions, read_segmentation

Picture = NDArray[np.uint8]
"""(H, W, 3), B, G, R."""

THUMBNAIL_WIDTH_PX: Final = 384
_JPEG_QUALITY: Final = 88
_MAX_ENLARGEMENT: Final = 8


@dataclass(frozen=True)
class FramePictures:
    """A frame's files, and how its segmentation was read."""

    storage: BlobStore
    files: Mapping[str, FileRow]
    report: Mapping[str, Any] | None

    def tag(self, *what: object) -> str:
        """Names a picture by everything that it is drawn from."""
        digests = [file.sha256 for _, file in sorted(self.files.items())]
        text = json.dumps([digests, self.report, what], default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:32]

    def layer(self, name: str) -> Picture:
        """The RGB image, the segmentation in its palette's colours, or both."""
        if name == "image":
            return self.image()
        if name == "segmentation":
            return self.segmentation()
        mixed = cv2.addWeighted(self.image(), 0.5, self.segmentation(), 0.5, 0)
        return np.asarray(mixed, np.uint8)

    def image(self) -> Picture:
        """The RGB image; without one, grey of the segmentation's size."""
        if "image" in self.files:
            return _decoded(self.storage.read(self.files["image"].sha256))
        return np.full_like(self.segmentation(), 96)

    def segmentation(self) -> Picture:
        """The segmentation as its palette paints it, whatever it was stored as."""
        if "segmentation" not in self.files or self.report is None:
            raise NotFound("segmentation of frame", "without one")
        content = self.storage.read(self.files["segmentation"].sha256)
        read = read_segmentation(content, _options(self.report))
        painted = FAMILIES[read.family].paint(read.tags)
        return np.ascontiguousarray(painted[:, :, ::-1])


def frame_pictures(
    storage: BlobStore, session: Session, frame_id: int
) -> FramePictures:
    """What can be drawn of a frame; NotFound."""
    frame = FrameRepository(session).with_id(frame_id)
    dataset = DatasetRepository(session).with_id(frame.dataset_id)
    reports = EvidenceRepository(session).reports(
        [frame_id], dataset.active_measurement_id or 0
    )
    files = FrameRepository(session).files([frame_id])[frame_id]
    return FramePictures(storage, files, reports.get(frame_id))


def visible_rectangle(decision: Mapping[str, Any]) -> list[float]:
    """The rectangle to cut out; NotFound for a box outside of the image."""
    xyxy: list[float] | None = decision["xyxy"]
    if xyxy is None:
        raise NotFound("picture of box outside of the image", decision["box_id"])
    return xyxy


def thumbnail(content: bytes) -> bytes:
    """A small JPEG of an image file."""
    # Decoding at a quarter of the size is three times faster than decoding it all.
    small = cv2.imdecode(
        np.frombuffer(content, np.uint8),
        cv2.IMREAD_REDUCED_COLOR_2 | cv2.IMREAD_IGNORE_ORIENTATION,
    )
    if small is None:
        raise Unprocessable("the image cannot be decoded", code="bad_image")
    height = max(1, round(small.shape[0] * THUMBNAIL_WIDTH_PX / small.shape[1]))
    resized = cv2.resize(
        small, (THUMBNAIL_WIDTH_PX, height), interpolation=cv2.INTER_AREA
    )
    return as_jpeg(np.asarray(resized, np.uint8))


def crop(picture: Picture, xyxy: Sequence[float], pad: float, height: int) -> bytes:
    """The part of a picture around a box as JPEG.

    `pad` is added on every side, in parts of the box's longer side.
    """
    rows, columns = picture.shape[:2]
    margin = pad * max(xyxy[2] - xyxy[0], xyxy[3] - xyxy[1], 1.0)
    x0 = int(np.clip(np.floor(xyxy[0] - margin), 0, columns - 1))
    y0 = int(np.clip(np.floor(xyxy[1] - margin), 0, rows - 1))
    x1 = int(np.clip(np.ceil(xyxy[2] + margin), x0 + 1, columns))
    y1 = int(np.clip(np.ceil(xyxy[3] + margin), y0 + 1, rows))
    part = picture[y0:y1, x0:x1]
    scale = min(height / part.shape[0], _MAX_ENLARGEMENT)
    size = (max(1, round(part.shape[1] * scale)), max(1, round(part.shape[0] * scale)))
    shrinks = scale < 1
    resized = cv2.resize(
        part, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC
    )
    return as_jpeg(np.asarray(resized, np.uint8))


def overlay(
    picture: Picture, decisions: Sequence[Mapping[str, Any]], *, edges: bool
) -> bytes:
    """A picture with boxes drawn on it as JPEG; without boxes, lossless PNG."""
    if not decisions:
        return as_png(picture)
    canvas = picture.copy()
    draw_boxes(canvas, decisions, edges=edges)
    return as_jpeg(canvas)


def as_jpeg(picture: Picture) -> bytes:
    """A picture as JPEG."""
    _, content = cv2.imencode(
        ".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    )
    return content.tobytes()


def as_png(picture: Picture) -> bytes:
    """A picture as PNG, quickly."""
    _, content = cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return content.tobytes()


def _options(report: Mapping[str, Any]) -> SegmentationOptions:
    return SegmentationOptions(
        palette=report["palette"],
        encoding=report["encoding"],
        channel_order=report["channel_order"],
        lossy="nearest" if report["lossy"] else "refuse",
    )


def _decoded(content: bytes) -> Picture:
    picture = cv2.imdecode(
        np.frombuffer(content, np.uint8),
        cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION,
    )
    if picture is None:
        raise Unprocessable("the image cannot be decoded", code="bad_image")
    return np.asarray(picture, np.uint8)
