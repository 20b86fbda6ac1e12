"""One frame as rows: files, boxes, evidence, decisions and tallies, all or nothing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from sqlalchemy.orm import Session

from app.db.base import utc_now
from app.db.tables import Dataset
from app.repositories.datasets import DatasetRepository
from app.repositories.evidence import EvidenceRepository
from app.repositories.frames import FrameRepository, NewBoxes
from app.repositories.tallies import TallyRepository
from app.services.frame_files import CheckedFiles
from app.services.frame_replacement import carry_reviews, retire
from app.services.measuring import packed
from app.services.statistics import tallies_of
from filter_core.annotation_types import FrameAnnotation
from filter_core.config import FilterConfig
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


def write_frame(
    session: Session, dataset: Dataset, content: FrameContent, config: FilterConfig
) -> int:
    """Insert the frame and decide its boxes; the id it got."""
    frames = FrameRepository(session)
    evidence = content.measured.evidence
    class_ids = DatasetRepository(session).class_ids(dataset, evidence.class_names)
    ids = [class_ids[name] for name in evidence.class_names]
    former = frames.current(dataset.id, content.key)
    frame_id = frames.take_ids("frames", 1)
    first_box_id = frames.take_ids("boxes", len(evidence)) if len(evidence) else 0
    if former is not None:
        retire(session, former)
    revision = 1 if former is None else former.revision + 1
    row = _frame_row(dataset, content)
    row |= {"id": frame_id, "first_box_id": first_box_id, "revision": revision}
    frames.add(row, content.files.rows)
    boxes = _box_rows(content, ids, frame_id, first_box_id)
    decisions = decide(evidence, config)
    rows = _decision_rows(dataset.id, boxes, content, decisions)
    frames.add_boxes(NewBoxes(boxes, rows))
    EvidenceRepository(session).add(
        [
            {
                "frame_id": frame_id,
                "measurement_id": dataset.active_measurement_id,
                **packed(content.measured, ids),
            }
        ]
    )
    TallyRepository(session).add(
        dataset.id,
        tallies_of((r["class_id"], r["reason"], r["toss_up"], None) for r in rows),
    )
    if former is not None:
        raws = [box.raw for box in content.annotation.boxes]
        carry_reviews(
            session,
            frames.with_id(former.id, annotation=True),
            [{**box, "raw": raw} for box, raw in zip(boxes, raws, strict=True)],
        )
    frames.forget_problems(dataset.id, content.key)
    return frame_id


def _frame_row(dataset: Dataset, content: FrameContent) -> dict[str, Any]:
    annotation = content.annotation
    width, height = content.files.image_wh
    return {
        "dataset_id": dataset.id,
        "key": content.key,
        "content_digest": content.digest,
        "config_id": dataset.active_config_id,
        "run_id": dataset.active_run_id,
        "box_count": len(annotation.boxes),
        "width": width,
        "height": height,
        "carla_version": annotation.carla_version,
        "map": annotation.map,
        "captured_at": annotation.captured_at,
        "annotation": annotation.raw,
        "created_by": content.sender,
        "created_at": utc_now(),
    }


def _box_rows(
    content: FrameContent, class_ids: list[int], frame_id: int, first_box_id: int
) -> list[dict[str, Any]]:
    index = content.measured.evidence.class_index.tolist()
    return [
        {
            "id": first_box_id + position,
            "frame_id": frame_id,
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
