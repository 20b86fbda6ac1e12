"""Responses about frames: lists, one frame with its boxes, files and pictures."""

from __future__ import annotations

import hashlib
import io
import json
import math
import tarfile
import threading
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Final

from sqlalchemy.orm import Session

from app.access.audit import AuditAction, AuditTrail
from app.access.service import require_own
from app.boxes.counts import count, summary
from app.boxes.current import DecisionRepository, retire
from app.boxes.drawing import (
    PNG,
    WEBP,
    Drawing,
    Layer,
    crop,
    overlay,
    slice_of_box,
    thumbnail,
)
from app.boxes.filter import TallyKey
from app.boxes.queries import (
    BANDS_M,
    FileRow,
    FrameRepository,
    GhostRepository,
    LatestAnswers,
)
from app.boxes.reader import (
    DecisionReader,
    StoredDecision,
    read_box,
    rectangles_of,
)
from app.catalog.datasets import DatasetRepository
from app.catalog.frames import ProblemRepository
from app.context import ServiceContext
from app.db.base import existing, filled
from app.db.tables import Dataset, Frame
from app.engine.children import PixelPool
from app.errors import DamagedFile, NoSuchFile, NotFound
from app.measuring.queries import EvidenceRepository
from app.security import Principal
from app.storage.base import BlobStore
from app.verdicts import effective_verdict
from filter_core.annotation.parsing import parse_annotation
from filter_core.errors import FilterError
from filter_core.evidence.depth import DepthSlice
from filter_core.images.drawing import DrawnBox
from filter_core.pipeline import SegmentationReport
from filter_core.segmentation.reading import SegmentationOptions
from filter_core.values import as_text
from filter_core.verdicts import VERDICTS
from unghost.wire.frames import (
    CropQuery,
    CropsQuery,
    FrameDetails,
    OverlayQuery,
    StoredFile,
)
from unghost.wire.words import TAR, FileKind, LayerName


def frame_summaries(
    session: Session, dataset: Dataset, frames: Sequence[Frame]
) -> list[dict[str, object]]:
    """Rows of a list of frames, each a `wire.FrameSummary` as a dict."""
    ids = [frame.id for frame in frames]
    files = FrameRepository(session).files(ids)
    tallies = DecisionRepository(session).per_frame(ids)
    measurement = filled(dataset.active_measurement_id)
    reports = EvidenceRepository(session).reports(ids, measurement)
    return [
        _summary(frame, files[frame.id], reports.get(frame.id), tallies[frame.id])
        for frame in frames
    ]


def _summary(
    frame: Frame,
    files: Mapping[str, FileRow],
    report: SegmentationReport | None,
    tallies: Mapping[TallyKey, int],
) -> dict[str, object]:
    return {
        "id": frame.id,
        "key": frame.key,
        "revision": frame.revision,
        "width": frame.width,
        "height": frame.height,
        "map": frame.map,
        "has_image": "image" in files,
        "has_segmentation": "segmentation" in files,
        "lossy": report is not None and report["lossy"],
        "created_at": frame.created_at,
        "counts": summary(count(tallies)),
    }


def report_of(session: Session, dataset: Dataset) -> dict[str, object]:
    """A `wire.Report`: where the ghosts of a dataset are."""
    ghosts = GhostRepository(session)
    bands: dict[int | None, Counter[str]] = defaultdict(_none_of_each)
    maps: dict[str | None, Counter[str]] = defaultdict(_none_of_each)
    weathers: dict[str | None, Counter[str]] = defaultdict(_none_of_each)
    for map_, weather, band, reason, answer, boxes in ghosts.by_place(dataset.id):
        verdict = effective_verdict(reason, answer)
        for counts in (bands[band], maps[map_], weathers[weather]):
            counts[verdict] += boxes
    ends: dict[int | None, int] = {end - 50: end for end in BANDS_M}
    in_turn = sorted(bands, key=lambda band: math.inf if band is None else band)
    ids = ghosts.worst_frames(dataset.id, WORST)
    frames = [FrameRepository(session).with_id(frame_id) for frame_id in ids]
    return {
        "by_distance": [
            {"distance_from": band, "distance_to": ends.get(band), **bands[band]}
            for band in in_turn
        ],
        "by_map": _by_name(maps),
        "by_weather": _by_name(weathers),
        "worst_frames": frame_summaries(session, dataset, frames),
    }


def _none_of_each() -> Counter[str]:
    return Counter({verdict.value: 0 for verdict in VERDICTS})


def _by_name(counts: Mapping[str | None, Counter[str]]) -> list[dict[str, object]]:
    """In order of name, boxes without one last; none if no frame has one."""
    names = sorted(counts, key=lambda name: (name is None, name or ""))
    return [] if names == [None] else [{"name": name, **counts[name]} for name in names]


WORST: Final = 12
"""Frames in a report."""


def describe_frame(session: Session, frame_id: int) -> dict[str, object]:
    """A `wire.Frame`; its decisions are dicts, since there may be thousands of them."""
    frame, details, decisions = _described(session, frame_id)
    previous_id, next_id = FrameRepository(session).neighbours(frame)
    return details.model_dump() | {
        "previous_id": previous_id,
        "next_id": next_id,
        "boxes": decisions,
    }


def describe_stored(session: Session, frame_id: int) -> dict[str, object]:
    """A `wire.StoredFrame`, the answer to an upload; its decisions are dicts."""
    _, details, decisions = _described(session, frame_id)
    return {
        "frame": details,
        "segmentation": details.segmentation,
        "decisions": decisions,
        "answers_set_aside": 0,
        "boxes_set_aside": (),
        "notes": (),
    }


def _described(
    session: Session, frame_id: int
) -> tuple[Frame, FrameDetails, list[StoredDecision]]:
    """A frame, its description, and its boxes as records."""
    frame = FrameRepository(session).with_id(frame_id, annotation=True)
    dataset = DatasetRepository(session).with_id(frame.dataset_id)
    reader = DecisionReader(session, dataset)
    boxes = reader.read_frames([frame_id])
    files = FrameRepository(session).files([frame_id])[frame_id]
    evidence = boxes.frames.get(frame_id)
    report = None if evidence is None else evidence.segmentation
    details = frame_details(frame, dataset.name, files, report, boxes.tallies())
    return frame, details, reader.records(boxes)


def frame_details(
    frame: Frame,
    dataset: str,
    files: Mapping[str, FileRow],
    report: SegmentationReport | None,
    tallies: Mapping[TallyKey, int],
) -> FrameDetails:
    """The description of a frame, from the arguments alone; runs no SQL."""
    return FrameDetails(
        **_summary(frame, files, report, tallies),
        dataset=dataset,
        camera=frame.annotation.get("camera"),
        carla_version=frame.carla_version,
        captured_text=frame.captured_at,
        weather=frame.annotation.get("weather"),
        sequence=as_text(frame.annotation.get("sequence")),
        split=as_text(frame.annotation.get("split")),
        superseded=frame.superseded_at is not None,
        segmentation=report,
        files={
            kind: StoredFile(
                url=f"/api/v1/frames/{frame.id}/{kind}",
                sha256=file.sha256,
                media_type=file.media_type,
                size_bytes=file.size_bytes,
            )
            for kind, file in files.items()
        },
    )


def frame_file(session: Session, frame_id: int, kind: FileKind) -> FileRow:
    """A file of a frame; NotFound if it has none of this kind."""
    FrameRepository(session).with_id(frame_id)
    file = FrameRepository(session).files([frame_id])[frame_id].get(kind)
    if file is None:
        raise NoSuchFile(kind, frame_id)
    return file


def remove_frame(audit: AuditTrail, by: Principal, dataset: Dataset, key: str) -> None:
    """Delete a frame with all its revisions, and the answers on them.

    With it go the classes that only frames have named, if no other box has them. Raises
    NotFound: there is no such frame; Forbidden: other people's answers are among them,
    and the caller is not an admin.
    """
    session = audit.session
    frames = FrameRepository(session)
    current = frames.current(dataset.id, key)
    answers = LatestAnswers(session).reviewers_of(dataset.id, key)
    of_others = require_own(by, answers, f"deleting frame {key!r}")
    retire(session, current)
    frames.remove(dataset.id, key)
    DatasetRepository(session).forget_unused_classes(dataset)
    ProblemRepository(session).forget(dataset.id, key)
    audit.note(
        AuditAction.FRAME_DELETED,
        key,
        dataset=dataset.name,
        answers=sum(answers.values()),
        of_others=of_others,
    )


@dataclass(frozen=True)
class FramePictures:
    """Draws pictures of a frame; `reading` is how its segmentation was read."""

    storage: BlobStore
    frame_id: int
    files: Mapping[str, FileRow]
    reading: SegmentationOptions | None

    def thumbnail(self, width: int) -> Drawing:
        """A picture of the image, so wide at most; raises NotFound if there is none."""
        if "image" not in self.files:
            raise NotFound("image of frame", self.frame_id)
        digest = self.files["image"].sha256

        def draw(pool: PixelPool, cancelled: threading.Event) -> bytes:
            image = self.storage.read(digest)
            return pool.run(thumbnail, image, width, cancelled=cancelled)

        return Drawing(f"{digest}-{width}", WEBP, draw, is_lasting=True)

    def crop(self, xyxy: Sequence[float], query: CropQuery) -> Drawing:
        """The part of a layer around a rectangle; raises NotFound."""
        layer, size = query.layer, (query.pad, query.height, query.least)
        self._require(layer)

        def draw(pool: PixelPool, cancelled: threading.Event) -> bytes:
            files = self._read(layer)
            return pool.run(crop, files, xyxy, *size, cancelled=cancelled)

        tag = self._tag("crop", xyxy, layer, *size)
        return Drawing(tag, WEBP, draw, is_lasting=True)

    def overlay(
        self, layer: LayerName, boxes: Sequence[DrawnBox], *, edges: bool
    ) -> Drawing:
        """A layer with boxes drawn on it; raises NotFound."""
        self._require(layer)

        def draw(pool: PixelPool, cancelled: threading.Event) -> bytes:
            files = self._read(layer)
            return pool.run(overlay, files, boxes, edges, cancelled=cancelled)

        tag = self._tag("overlay", layer, "3d" if edges else "2d", boxes)
        return Drawing(tag, WEBP if boxes else PNG, draw)

    def _tag(self, *what: object) -> str:
        digests = [file.sha256 for _, file in sorted(self.files.items())]
        text = json.dumps([digests, self.reading, what], default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:32]

    def _require(self, layer: LayerName) -> None:
        if layer in _OF_ONE_FILE:
            if layer not in self.files:
                raise NoSuchFile(layer, self.frame_id)
            return
        needs_segmentation = layer != "image" or "image" not in self.files
        if needs_segmentation and (
            "segmentation" not in self.files or self.reading is None
        ):
            raise NotFound("measured segmentation of frame", self.frame_id)

    def _read(self, layer: LayerName) -> Layer:
        needed: Sequence[str] = ("image", "segmentation")
        if layer == "segmentation" or layer in _OF_ONE_FILE:
            needed = (layer,)
        elif layer == "image" and "image" in self.files:
            needed = ("image",)
        read = {
            kind: self.storage.read(file.sha256)
            for kind, file in self.files.items()
            if kind in needed
        }
        files = (read.get("image"), read.get("segmentation"))
        measured = read[layer] if layer in _OF_ONE_FILE else None
        return Layer(layer, *files, self.reading, measured)


_OF_ONE_FILE: Final = ("depth", "instances")
"""Layers that are painted from the file of this kind alone."""


def frame_pictures(
    storage: BlobStore, session: Session, frame_id: int
) -> FramePictures:
    """The pictures that can be drawn of a frame; raises NotFound."""
    frame = FrameRepository(session).with_id(frame_id)
    dataset = DatasetRepository(session).with_id(frame.dataset_id)
    evidence = EvidenceRepository(session)
    measurement = filled(dataset.active_measurement_id)
    report = evidence.reports([frame_id], measurement).get(frame_id)
    files = FrameRepository(session).files([frame_id])[frame_id]
    if report is None:
        return FramePictures(storage, frame_id, files, None)
    # As it was measured, so that it gets the same tags.
    reading = SegmentationOptions(
        palette=report["palette"],
        encoding=report["encoding"],
        channel_order=report["channel_order"],
        lossy="nearest" if report["lossy"] else "refuse",
    )
    options = evidence.measurement_with_id(measurement).options
    changed = {name: options[name] for name in ("tags", "tag_scale") if name in options}
    if changed:
        # What the report names may be another palette than the file's.
        palette, version = options["reading"]["palette"], frame.carla_version
        reading = replace(reading, palette=palette, carla_version=version, **changed)
    return FramePictures(storage, frame_id, files, reading)


def crop_of(
    storage: BlobStore, session: Session, box_id: int, query: CropQuery
) -> Drawing:
    """The part of a frame around a box; NotFound if the box is outside of the image."""
    _, boxes = read_box(session, box_id)
    pictures = frame_pictures(storage, session, boxes.rows.frame_ids[0])
    (xyxy,) = boxes.rectangles()
    xyxy = existing(xyxy, "rectangle in the image of box", box_id)
    return pictures.crop(xyxy, query)


def crops_of(
    storage: BlobStore, session: Session, crops: CropsQuery, folder: Path
) -> Drawing:
    """Crops around several boxes, as a tar: an empty file where there is no picture.

    Those that cannot be drawn are missing. `folder` has the pictures that are kept.
    """
    parts = crops.parts()
    rectangles = rectangles_of(session, {box_id for box_id, _ in parts.values()})
    pictures_of = cache(partial(frame_pictures, storage, session))
    drawings: dict[str, Drawing | None] = {}
    for words, (box_id, query) in parts.items():
        drawings[words] = None
        if box_id in rectangles:
            frame_id, xyxy = rectangles[box_id]
            with suppress(NotFound):
                drawings[words] = pictures_of(frame_id).crop(xyxy, query)

    def draw(pool: PixelPool, cancelled: threading.Event) -> bytes:
        content = io.BytesIO()
        with tarfile.open(fileobj=content, mode="w") as archive:
            for words, drawing in drawings.items():
                with suppress(FilterError, DamagedFile):
                    picture = b""
                    if drawing is not None:
                        picture = drawing.content(pool, cancelled, folder)
                    member = tarfile.TarInfo(f"{words}.webp")
                    member.size = len(picture)
                    archive.addfile(member, io.BytesIO(picture))
            end = archive.offset + 2 * tarfile.BLOCKSIZE
        return content.getvalue()[:end]  # without the zeros that fill a tape's record

    tags = [f"{words} {drawing and drawing.tag}" for words, drawing in drawings.items()]
    tag = hashlib.sha256("\n".join(tags).encode()).hexdigest()[:32]
    return Drawing(tag, TAR, draw)


def slice_of(context: ServiceContext, session: Session, box_id: int) -> DepthSlice:
    """Where a box and its pixels are on the axis of depth.

    Raises NotFound: the box is not in the image, or its frame has no depth image;
    FilterError: the depth image cannot be read.
    """
    _, boxes = read_box(session, box_id)
    (xyxy,) = boxes.rectangles()
    xyxy = existing(xyxy, "rectangle in the image of box", box_id)
    frame_id = boxes.rows.frame_ids[0]
    frame = FrameRepository(session).with_id(frame_id, annotation=True)
    content = context.storage.read(frame_file(session, frame_id, "depth").sha256)
    annotation = replace(parse_annotation(frame.annotation, frame=frame.key), raw={})
    position = box_id - filled(frame.first_box_id)
    return context.drawers.run(slice_of_box, content, annotation, position, xyxy)


def overlay_of(
    storage: BlobStore, session: Session, frame_id: int, query: OverlayQuery
) -> Drawing:
    """A frame with the requested boxes drawn on it; raises NotFound."""
    pictures = frame_pictures(storage, session, frame_id)
    drawn_verdicts = query.verdicts()
    drawn: list[DrawnBox] = []
    if drawn_verdicts:
        frame = FrameRepository(session).with_id(frame_id)
        dataset = DatasetRepository(session).with_id(frame.dataset_id)
        boxes = DecisionReader(session, dataset).read_frames([frame_id])
        verdicts = [VERDICTS[code].value for code in boxes.labels.effective.tolist()]
        edges = boxes.projected(edges=True).edges
        lines = [None if each is None else each.tolist() for each in edges]
        every = map(DrawnBox, verdicts, boxes.rectangles(), lines)
        drawn = [box for box in every if box.verdict in drawn_verdicts]
    return pictures.overlay(query.layer, drawn, edges=query.edges == "3d")
