"""One frame as rows, all or nothing, and as the answer to its upload."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from typing import Any

import numpy as np
from sqlalchemy.orm import Session

from app import metrics
from app.access.audit import Act, AuditTrail
from app.boxes.counts import count, summary, tallies_of
from app.boxes.current import TallyRepository, require_own, retire
from app.boxes.frames import stored_files
from app.boxes.queries import FileRow, FrameRepository, NewBoxes
from app.boxes.reader import (
    StoredDecision,
    accepted_tags,
    current_review,
    rounded_edges,
)
from app.db.base import utc_now
from app.db.engine import once_committed
from app.db.tables import Frame
from app.ingest.files import CheckedFiles
from app.measuring.active import ActiveDataset
from app.measuring.evidence import packed
from app.measuring.queries import (
    DatasetRepository,
    EvidenceRepository,
    KeyRow,
    ProblemRepository,
)
from app.review.service import carry_reviews
from app.security import Principal
from app.verdicts import effective_verdict
from filter_core.annotation.frame import FrameAnnotation
from filter_core.decisions.record import decision_dicts
from filter_core.decisions.rules import decide
from filter_core.pipeline import MeasuredFrame
from filter_core.types import Decisions, Reason
from unghost.wire.frames import FrameDetails


def describe_new(
    active: ActiveDataset, content: FrameContent, written: WrittenFrame
) -> dict[str, Any]:
    """A `wire.StoredFrame`; its decisions are dicts, with answers that came along."""
    frame = _frame(active, content, written)
    return {
        "frame": frame,
        "segmentation": frame.segmentation,
        "decisions": _decisions(active, content, written),
    }


def _frame(
    active: ActiveDataset, content: FrameContent, written: WrittenFrame
) -> FrameDetails:
    files = {row.kind: row for row in content.files.rows}
    report, raw = content.measured.segmentation, content.annotation.raw
    decided = zip(
        content.measured.evidence.class_index.tolist(),
        written.decisions.reason.tolist(),
        written.decisions.toss_up.tolist(),
        strict=True,
    )
    answers = {row["box_id"]: row["verdict"] for row in written.carried}
    alike = tallies_of(
        (index, reason, toss, answers.get(box_id))
        for box_id, (index, reason, toss) in enumerate(decided, written.first_box_id)
    )
    width, height = content.files.image_wh
    return FrameDetails(
        id=written.frame_id,
        key=content.key,
        revision=written.revision,
        width=width,
        height=height,
        map=content.annotation.map,
        has_image="image" in files,
        has_segmentation="segmentation" in files,
        lossy=content.measured.lossy,
        created_at=written.created_at,
        counts=summary(count(alike)),
        dataset=active.name,
        camera=raw.get("camera"),
        carla_version=content.annotation.carla_version,
        captured_text=content.annotation.captured_at,
        weather=raw.get("weather"),
        superseded=False,
        segmentation=report,
        files=stored_files(written.frame_id, files),
    )


def _decisions(
    active: ActiveDataset, content: FrameContent, written: WrittenFrame
) -> list[StoredDecision]:
    measured, geometry = content.measured, content.measured.geometry
    if written.revision > 1:  # answered as if it was read, as it always has been
        edges = [None if one is None else rounded_edges(one) for one in geometry.edges]
        geometry = replace(geometry, edges=edges)
    facts = measured.facts(active.config)
    composed = decision_dicts(
        facts,
        measured.ids,
        measured.evidence,
        written.decisions,
        geometry,
    )
    masks = measured.evidence.accept_mask.tolist()
    tags = {mask: accepted_tags(facts.family, mask) for mask in set(masks)}
    described: list[StoredDecision] = [
        {
            **decision,
            "frame": content.key,
            "box_id": written.first_box_id + position,
            "frame_id": written.frame_id,
            "run": active.row.run_id,
            "config": active.row.config_digest,
            "revision": 0,
            "review": None,
            "effective_verdict": decision["verdict"],
            "accepted_tags": tags[mask],
        }
        for position, (decision, mask) in enumerate(zip(composed, masks, strict=True))
    ]
    for row in written.carried:
        position = row["box_id"] - written.first_box_id
        reason = int(written.decisions.reason[position])
        described[position] |= {
            "revision": row["revision"],
            "review": current_review(row),
            "effective_verdict": effective_verdict(reason, row["verdict"]),
        }
    return described


@dataclass(frozen=True)
class FrameContent:
    """A frame that is ready to be stored."""

    key: str
    digest: str
    sender: Principal
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
    carried: Sequence[Mapping[str, Any]] = ()
    """Answers that came along from the revision before, as rows."""


def write_frames(
    session: Session,
    active: ActiveDataset,
    work: Sequence[tuple[FrameContent, KeyRow]],
) -> list[WrittenFrame]:
    """Insert frames of different keys and decide their boxes.

    Each comes with what its key had before: the revision that it replaces, if any.
    """
    frames = FrameRepository(session)
    formers = [
        None if known.frame_id is None else frames.with_id(known.frame_id)
        for _, known in work
    ]
    for former in formers:
        if former is not None:
            retire(session, former)
    contents = [content for content, _ in work]
    written = _numbered(session, active, contents, formers)
    rows = _Rows(active, _class_ids(session, active, contents))
    for content, row in zip(contents, written, strict=True):
        rows.add(content, row)
    rows.insert(session)
    for number, former in enumerate(formers):
        if former is not None:
            content, row = contents[number], written[number]
            boxes = _with_what_was_decided(rows.boxes_of(content.key), content, row)
            carried = _replaced(session, active.name, former, content, boxes)
            written[number] = replace(row, carried=carried)
    for content, known in work:
        if known.has_problem:
            ProblemRepository(session).forget(active.row.dataset_id, content.key)
    once_committed(session, partial(_count, contents, written))
    return written


def _count(contents: Sequence[FrameContent], written: Sequence[WrittenFrame]) -> None:
    metrics.FRAMES.add(len(contents))
    for content in contents:
        for file in content.files.rows:
            metrics.FRAME_BYTES.add(file.size_bytes, file.kind)
    reasons = np.concatenate([row.decisions.reason for row in written])
    metrics.BOXES.add(len(reasons))
    for number, boxes in enumerate(np.bincount(reasons).tolist()):
        if boxes:
            reason = Reason(number)
            metrics.DECISIONS.add(boxes, reason.verdict.value, reason.label)


def _numbered(
    session: Session,
    active: ActiveDataset,
    contents: Sequence[FrameContent],
    formers: Sequence[Frame | None],
) -> list[WrittenFrame]:
    sizes = [len(content.measured.evidence) for content in contents]
    frame_id, box_id = FrameRepository(session).take_ids(len(sizes), sum(sizes))
    written = []
    for content, former, size in zip(contents, formers, sizes, strict=True):
        written.append(
            WrittenFrame(
                frame_id=frame_id,
                first_box_id=box_id,
                revision=1 if former is None else former.revision + 1,
                created_at=utc_now(),
                decisions=decide(content.measured.evidence, active.config),
            )
        )
        frame_id, box_id = frame_id + 1, box_id + size
    return written


def _class_ids(
    session: Session, active: ActiveDataset, contents: Sequence[FrameContent]
) -> dict[str, int]:
    names = dict.fromkeys(
        name for content in contents for name in content.measured.evidence.class_names
    )
    datasets = DatasetRepository(session)
    known = datasets.classes(active.row.dataset_id)
    if known.keys() >= names.keys():
        return known
    return datasets.class_ids(datasets.named(active.name), list(names))


class _Rows:
    """Rows of several frames, table by table."""

    def __init__(self, active: ActiveDataset, class_ids: Mapping[str, int]) -> None:
        self._active, self._class_ids = active, class_ids
        self._frames: list[dict[str, Any]] = []
        self._files: dict[int, Sequence[FileRow]] = {}
        self._boxes: dict[str, list[dict[str, Any]]] = {}
        self._decisions: list[dict[str, Any]] = []
        self._evidence: list[dict[str, Any]] = []

    def boxes_of(self, key: str) -> list[dict[str, Any]]:
        """The boxes of the frame under a key."""
        return self._boxes[key]

    def add(self, content: FrameContent, written: WrittenFrame) -> None:
        """One more frame."""
        row = self._active.row
        names = content.measured.evidence.class_names
        class_ids = [self._class_ids[name] for name in names]
        boxes = _box_rows(content, class_ids, written)
        self._frames.append(_frame_row(self._active, content, written))
        self._files[written.frame_id] = content.files.rows
        self._boxes[content.key] = boxes
        self._decisions += _decision_rows(
            row.dataset_id, boxes, content, written.decisions
        )
        self._evidence.append(
            {
                "frame_id": written.frame_id,
                "measurement_id": row.measurement_id,
                **packed(content.measured, class_ids),
            }
        )

    def insert(self, session: Session) -> None:
        """All of them."""
        FrameRepository(session).add(self._frames, self._files)
        boxes = [box for each in self._boxes.values() for box in each]
        FrameRepository(session).add_boxes(NewBoxes(boxes, self._decisions))
        EvidenceRepository(session).add(self._evidence)
        alike = (
            (r["class_id"], r["reason"], r["toss_up"], None) for r in self._decisions
        )
        TallyRepository(session).add(self._active.row.dataset_id, tallies_of(alike))


def _with_what_was_decided(
    boxes: Sequence[Mapping[str, Any]], content: FrameContent, written: WrittenFrame
) -> list[dict[str, Any]]:
    columns = zip(
        boxes,
        content.annotation.boxes,
        written.decisions.reason.tolist(),
        written.decisions.toss_up.tolist(),
        strict=True,
    )
    return [
        {**row, "raw": box.raw, "reason": reason, "toss_up": toss_up}
        for row, box, reason, toss_up in columns
    ]


def _replaced(
    session: Session,
    dataset: str,
    former: Frame,
    content: FrameContent,
    boxes: Sequence[Mapping[str, Any]],
) -> Sequence[Mapping[str, Any]]:
    """Carry answers over and note those set aside; Forbidden if they are others'."""
    carried, set_aside = carry_reviews(session, former, boxes)
    sender, act = content.sender, f"replacing frame {content.key!r}"
    of_others = require_own(sender, set_aside, act)
    AuditTrail(session, sender).note(
        Act.FRAME_REPLACED,
        content.key,
        dataset=dataset,
        revision=former.revision + 1,
        answers=sum(set_aside.values()),
        of_others=of_others,
    )
    return carried


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
        "created_by": content.sender.name,
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
