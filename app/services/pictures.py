"""Pictures that are drawn on request: what they are made of, and the latest ones."""

from __future__ import annotations

import hashlib
import json
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy.orm import Session

from app.engine.pixels import PixelPool
from app.errors import NotFound
from app.repositories.datasets import DatasetRepository
from app.repositories.evidence import EvidenceRepository
from app.repositories.frames import FileRow, FrameRepository
from app.services.drawing import DrawnBox, Layer, LayerName, crop, overlay, thumbnail
from app.storage import BlobStore
from filter_core.errors import FilterError

JPEG: Final = "image/jpeg"
PNG: Final = "image/png"
MOST_REFUSED: Final = 1000
KEPT_BYTES: Final = 64 * 1024**2
"""What is kept of pictures that were drawn: some 4,000 crops."""


@dataclass(frozen=True)
class Drawing:
    """A picture that can be drawn: what it shows is known, its files are not read yet.

    Attributes
    ----------
    tag : str
        Names the picture by everything that it is drawn from.
    media_type : str
    draw : function of a PixelPool and what `PixelPool.run` takes beside it
        Reads the files and returns the encoded picture.
    """

    tag: str
    media_type: str
    draw: Callable[[PixelPool, threading.Event], bytes]


class DrawnPictures:
    """Pictures that were drawn lately, by their tags; usable by any thread.

    What cannot be drawn is remembered as well: it would cost as much each time.
    """

    def __init__(self, most_bytes: int = KEPT_BYTES) -> None:
        self._most_bytes = most_bytes
        self._held: OrderedDict[str, bytes] = OrderedDict()
        self._bytes = 0
        self._refused: OrderedDict[str, FilterError] = OrderedDict()
        self._changing = threading.Lock()

    def find(self, tag: str) -> bytes | None:
        """A picture that is still held; raises what was refused under the tag."""
        with self._changing:
            if tag in self._refused:
                raise self._refused[tag]
            content = self._held.get(tag)
            if content is not None:
                self._held.move_to_end(tag)
            return content

    def keep(self, tag: str, content: bytes) -> None:
        """Hold a picture, in place of those that were not asked for the longest."""
        with self._changing:
            if len(content) > self._most_bytes // 4:
                return  # in place of it many others are held
            self._bytes += len(content) - len(self._held.pop(tag, b""))
            self._held[tag] = content
            while self._bytes > self._most_bytes:
                self._bytes -= len(self._held.popitem(last=False)[1])

    def refuse(self, tag: str, error: FilterError) -> None:
        """Remember that this cannot be drawn, and why."""
        with self._changing:
            self._refused[tag] = error
            while len(self._refused) > MOST_REFUSED:
                self._refused.popitem(last=False)


@dataclass(frozen=True)
class FramePictures:
    """A frame's files, and how its segmentation was read."""

    storage: BlobStore
    files: Mapping[str, FileRow]
    report: Mapping[str, Any] | None

    def thumbnail(self) -> Drawing:
        """A small picture of the image; NotFound."""
        if "image" not in self.files:
            raise NotFound("image of frame", "without one")
        digest = self.files["image"].sha256

        def draw(pool: PixelPool, given_up: threading.Event) -> bytes:
            image = self.storage.read(digest)
            return pool.run(thumbnail, image, given_up=given_up)

        return Drawing(f"{digest}-thumbnail", JPEG, draw)

    def crop(
        self, layer: LayerName, xyxy: Sequence[float], pad: float, height: int
    ) -> Drawing:
        """The part of a layer around a rectangle; NotFound."""
        self._require(layer)

        def draw(pool: PixelPool, given_up: threading.Event) -> bytes:
            files = self._read(layer)
            return pool.run(crop, files, xyxy, pad, height, given_up=given_up)

        return Drawing(self._tag("crop", xyxy, layer, pad, height), JPEG, draw)

    def overlay(
        self, layer: LayerName, boxes: Sequence[DrawnBox], *, edges: bool
    ) -> Drawing:
        """A layer with boxes drawn on it; NotFound."""
        self._require(layer)

        def draw(pool: PixelPool, given_up: threading.Event) -> bytes:
            files = self._read(layer)
            return pool.run(overlay, files, boxes, edges, given_up=given_up)

        tag = self._tag("overlay", layer, "3d" if edges else "2d", boxes)
        return Drawing(tag, JPEG if boxes else PNG, draw)

    def _tag(self, *what: object) -> str:
        digests = [file.sha256 for _, file in sorted(self.files.items())]
        text = json.dumps([digests, self.report, what], default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:32]

    def _require(self, layer: LayerName) -> None:
        needs_segmentation = layer != "image" or "image" not in self.files
        if needs_segmentation and (
            "segmentation" not in self.files or self.report is None
        ):
            raise NotFound("segmentation of frame", "without one")

    def _read(self, layer: LayerName) -> Layer:
        needed = {"image", "segmentation"}
        if layer == "segmentation":
            needed = {"segmentation"}
        elif layer == "image" and "image" in self.files:
            needed = {"image"}
        read = {
            kind: self.storage.read(file.sha256)
            for kind, file in self.files.items()
            if kind in needed
        }
        return Layer(layer, read.get("image"), read.get("segmentation"), self.report)


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
