"""One frame as rows: files, boxes, evidence, decisions and tallies, all or nothing."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy.orm import Session

from app.db.base import utc_now
from app.repositories.datasets import DatasetRepository
from app.repositories.evidence import EvidenceRepository
from app.repositories.frames import FrameRepository, NewBoxes
from app.repositories.tallies import TallyRepository
from app.services.active import ActiveDataset
from app.services.frame_files import CheckedFiles
from app.services.frame_replacement import carry_reviews, retire
from app.services.measuring import packed
from app.services.statistics import tallies_of
from filter_core.annotation_types import FrameAnnotation
from filter_core.decide import decide
from filter_core.frame_filter import MeasuredFrame
from filter_core.types import Decisions


@dataclass(frozen=True)
class FrameContent:
    """A frame that is ready to be stored."""

    key: str
    digest: str
    sender: str
    annotation: FrameAnnotation
    files: CheckedFiles
    measured: MeasuredFrame


@dataclass(frozen=True)
class WrittenFrame:
    """What the database gave a new frame, and what was decided."""

    frame_id: int
    first_box_id: int
    revision: int
    created_at: datetime
    decisions: Decisions


def write_frame(
    session: Session, active: ActiveDataset, content: FrameContent, *, replaces: bool
) -> WrittenFrame:
    """Insert the frame and decide its boxes."""
    frames, dataset_id = FrameRepository(session), active.row.dataset_id
    former = frames.current(dataset_id, content.key) if replaces else None
    evidence = content.measured.evidence
    written = WrittenFrame(
        frame_id=frames.take_ids("frames", 1),
        first_box_id=frames.take_ids("boxes", len(evidence)),
        revision=1 if former is None else former.revision + 1,
        created_at=utc_now(),
        decisions=decide(evidence, active.config),
    )
    if former is not None:
        retire(session, former)
    class_ids = _class_ids(session, active, evidence.class_names)
    frames.add(_frame_row(active, content, written), content.files.rows)
    boxes = _box_rows(content, class_ids, written)
    rows = _decision_rows(dataset_id, boxes, content, written.decisions)
    frames.add_boxes(NewBoxes(boxes, rows))
    measured = {
        "frame_id": written.frame_id,
        "measurement_id": active.row.measurement_id,
        **packed(content.measured, class_ids),
    }
    EvidenceRepository(session).add([measured])
    alike = ((r["class_id"], r["reason"], r["toss_up"], None) for r in rows)
    TallyRepository(session).add(dataset_id, tallies_of(alike))
    if former is not None:
        _carry(session, former.id, content, boxes)
    frames.forget_problems(dataset_id, content.key)
    return written


def _class_ids(
    session: Session, active: ActiveDataset, names: Sequence[str]
) -> list[int]:
    datasets = DatasetRepository(session)
    known = datasets.classes(active.row.dataset_id)
    if not known.keys() >= set(names):
        known = datasets.class_ids(datasets.named(active.name), names)
    return [known[name] for name in names]


def _carry(
    session: Session,
    former_id: int,
    content: FrameContent,
    boxes: Sequence[Mapping[str, Any]],
) -> None:
    raws = [box.raw for box in content.annotation.boxes]
    carry_reviews(
        session,
        FrameRepository(session).with_id(former_id, annotation=True),
        [{**box, "raw": raw} for box, raw in zip(boxes, raws, strict=True)],
    )


def _frame_row(
    active: ActiveDataset, content: FrameContent, written: WrittenFrame
) -> dict[str, Any]:
    annotation = content.annotation
    width, height = content.files.image_wh
    return {
        "id": written.frame_id,
        "first_box_id": written.first_box_id,
        "revision": written.revision,
        "dataset_id": active.row.dataset_id,
        "key": content.key,
        "content_digest": content.digest,
        "config_id": active.row.config_id,
        "run_id": active.row.run_id,
        "box_count": len(annotation.boxes),
        "width": width,
        "height": height,
        "carla_version": annotation.carla_version,
        "map": annotation.map,
        "captured_at": annotation.captured_at,
        "annotation": annotation.raw,
        "created_by": content.sender,
        "created_at": written.created_at,
    }


def _box_rows(
    content: FrameContent, class_ids: list[int], written: WrittenFrame
) -> list[dict[str, Any]]:
    index = content.measured.evidence.class_index.tolist()
    return [
        {
            "id": written.first_box_id + position,
            "frame_id": written.frame_id,
            "class_id": class_ids[index[position]],
            "source_id": box.id,
        }
        for position, box in enumerate(content.annotation.boxes)
    ]


def _decision_rows(
    dataset_id: int,
    boxes: list[dict[str, Any]],
    content: FrameContent,
    decisions: Decisions,
) -> list[dict[str, Any]]:
    evidence = content.measured.evidence
    columns = zip(
        boxes,
        evidence.match_percent.tolist(),
        evidence.crowding.tolist(),
        evidence.distance.tolist(),
        decisions.reason.tolist(),
        decisions.large.tolist(),
        decisions.toss_up.tolist(),
        strict=True,
    )
    return [
        {
            "box_id": box["id"],
            "dataset_id": dataset_id,
            "frame_id": box["frame_id"],
            "class_id": box["class_id"],
            "match_percent": _known(match),
            "crowding": _known(crowding) or 0.0,
            "distance": _known(distance),
            "reason": reason,
            "large": large,
            "toss_up": toss_up,
            "revision": 0,
        }
        for box, match, crowding, distance, reason, large, toss_up in columns
    ]


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value
