"""Inserts new frames in one transaction, and describes them for the response.

A frame that replaces an earlier revision takes over people's answers on boxes that are
the same in both (`_carry_answers`).
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from app import metrics
from app.access.audit import AuditAction, AuditTrail
from app.access.service import require_own
from app.boxes import current
from app.boxes.counts import tallies_of
from app.boxes.frames import frame_details
from app.boxes.queries import FrameRepository, LatestAnswers, LatestReview
from app.boxes.reader import (
    DecidedFrame,
    StoredDecision,
    asked_decisions,
    covering_words,
    rounded_edges,
    stored_decision,
)
from app.catalog.datasets import DatasetRepository
from app.catalog.frames import KeyRow, ProblemRepository
from app.db.base import utc_now
from app.db.engine import once_committed
from app.db.tables import Frame
from app.ingest.frame import AcceptedFrame, ReadyFrame
from app.measuring.active import ActiveDataset
from app.measuring.evidence import packed
from app.measuring.queries import EvidenceRepository
from app.review.queries import ReviewRepository
from app.security import Principal
from filter_core.annotation.frame import FORMS_3D, GEOMETRIES
from filter_core.decisions.doubt import Cause, Doubts, doubts, questions
from filter_core.decisions.explain import BoxName
from filter_core.decisions.record import decision_dicts
from filter_core.decisions.rules import decide
from filter_core.errors import error_context
from filter_core.evidence.crowding import most_covering
from filter_core.verdicts import VERDICT_OF_REASON, VERDICTS, Decisions, Reason
from unghost.wire.datasets import VerdictCounts
from unghost.wire.frames import MOST_BOXES_SET_ASIDE


@dataclass(frozen=True, kw_only=True)
class NewFrame(AcceptedFrame):
    """A frame that this upload has stored, with the content of its rows.

    `carried` are the answers that were carried over from the former revision.
    """

    ready: ReadyFrame
    active: ActiveDataset
    first_box_id: int
    revision: int
    created_by: str
    created_at: datetime
    decisions: Decisions
    doubts: Doubts
    carried: Sequence[LatestReview] = ()

    @property
    def boxes(self) -> int:
        return len(self.decisions.reason)

    @property
    def box_ids(self) -> list[int]:
        """The server's ids of its boxes, in the order of the annotation."""
        return list(range(self.first_box_id, self.first_box_id + self.boxes))

    def describe(self) -> dict[str, object]:
        answers = {answer.box_id: answer.verdict for answer in self.carried}
        alike = tallies_of(
            zip(
                self.ready.measured.evidence.class_index.tolist(),
                self.decisions.reason.tolist(),
                self.decisions.toss_up.tolist(),
                self.doubts.doubt.tolist(),
                map(answers.get, self.box_ids),
                strict=True,
            )
        )
        frame = frame_details(
            Frame(**_frame_row(self)),
            self.active.name,
            {file.kind: file for file in self.ready.files},
            self.ready.measured.segmentation,
            alike,
        )
        return {
            "frame": frame,
            "segmentation": frame.segmentation,
            "decisions": _decisions(self),
            "answers_set_aside": self.answers_set_aside,
            "boxes_set_aside": self.boxes_set_aside,
            "notes": self.ready.measured.notes,
        }


def insert_frames(
    session: Session,
    active: ActiveDataset,
    sender: Principal,
    frames: Sequence[ReadyFrame],
    key_rows: Mapping[str, KeyRow],
) -> list[NewFrame]:
    """Insert frames of different keys and decide their boxes.

    `key_rows` has the current row of each key: the revisions that they replace, if any.
    """
    if not frames:
        return []
    repository = FrameRepository(session)
    former_ids = {frame.key: key_rows[frame.key].frame_id for frame in frames}
    formers = {
        key: repository.with_id(frame_id)
        for key, frame_id in former_ids.items()
        if frame_id is not None
    }
    for former in formers.values():
        current.retire(session, former)
    new = _numbered(session, active, sender, frames, formers)
    class_ids = _class_ids(session, active, frames)
    _insert(session, active, new, class_ids)
    for place, frame in enumerate(new):
        if frame.key in formers:
            new[place] = _carried(session, sender, formers[frame.key], frame, class_ids)
        if key_rows[frame.key].has_problem:
            ProblemRepository(session).forget(active.row.dataset_id, frame.key)
    once_committed(session, partial(_count_in_metrics, new))
    return new


def _numbered(
    session: Session,
    active: ActiveDataset,
    sender: Principal,
    frames: Sequence[ReadyFrame],
    formers: Mapping[str, Frame],
) -> list[NewFrame]:
    sizes = [len(frame.measured.evidence) for frame in frames]
    frame_id, box_id = FrameRepository(session).take_ids(len(sizes), sum(sizes))
    new = []
    for ready, size in zip(frames, sizes, strict=True):
        former = formers.get(ready.key)
        evidence = ready.measured.evidence
        decisions = decide(evidence, active.config)
        new.append(
            NewFrame(
                ready.key,
                frame_id,
                verdict_counts(decisions.reason),
                ready=ready,
                active=active,
                first_box_id=box_id,
                revision=1 if former is None else former.revision + 1,
                created_by=sender.name,
                created_at=utc_now(),
                decisions=decisions,
                doubts=doubts(evidence, active.config, decisions),
            )
        )
        frame_id, box_id = frame_id + 1, box_id + size
    return new


def verdict_counts(reasons: NDArray[np.uint8]) -> VerdictCounts:
    """How many boxes have each verdict, by their reasons."""
    boxes = np.bincount(VERDICT_OF_REASON[reasons], minlength=len(VERDICTS)).tolist()
    return VerdictCounts(
        **{verdict.value: boxes[code] for code, verdict in enumerate(VERDICTS)}
    )


def _class_ids(
    session: Session, active: ActiveDataset, frames: Sequence[ReadyFrame]
) -> dict[str, int]:
    """Ids of the dataset's classes; those that only these frames have are added."""
    names = {name for frame in frames for name in frame.measured.evidence.class_names}
    datasets = DatasetRepository(session)
    classes = datasets.listed_classes(active.row.dataset_id)
    if classes.keys() >= names:
        return classes
    dataset = datasets.named(active.name)
    for frame in frames:
        with error_context(frame.key):
            classes = datasets.class_ids(dataset, frame.measured.evidence.class_names)
    return classes


def _insert(
    session: Session,
    active: ActiveDataset,
    frames: Sequence[NewFrame],
    class_ids: Mapping[str, int],
) -> None:
    """Insert rows of frames, files, boxes, decisions and evidence; update tallies."""
    row, repository = active.row, FrameRepository(session)
    boxes: dict[str, list[object]] = defaultdict(list)
    decisions: dict[str, list[object]] = defaultdict(list)
    rows = []
    for frame in frames:
        measured, evidence = frame.ready.measured, frame.ready.measured.evidence
        ids_of_classes = [class_ids[name] for name in evidence.class_names]
        of_frame = [frame.frame_id] * frame.boxes
        of_class = [ids_of_classes[each] for each in evidence.class_index.tolist()]
        boxes["id"] += frame.box_ids
        boxes["frame_id"] += of_frame
        boxes["class_id"] += of_class
        boxes["source_id"] += measured.ids
        columns = {
            "box_id": frame.box_ids,
            "dataset_id": [row.dataset_id] * frame.boxes,
            "frame_id": of_frame,
            "class_id": of_class,
            **current.numbers_of_lists(evidence),
            **current.Decided.of(frame.decisions, frame.doubts.doubt).columns(),
            "revision": [0] * frame.boxes,
        }
        for name, numbers in columns.items():
            decisions[name] += numbers
        ids = {"frame_id": frame.frame_id, "measurement_id": row.measurement_id}
        rows.append({**ids, **packed(measured, ids_of_classes)})
    repository.add(
        [_frame_row(frame) for frame in frames],
        {frame.frame_id: frame.ready.files for frame in frames},
    )
    repository.add_boxes(boxes)
    current.add(session, row.dataset_id, decisions)
    EvidenceRepository(session).add(rows)


def _frame_row(frame: NewFrame) -> dict[str, object]:
    row, annotation = frame.active.row, frame.ready.measured.annotation
    width, height = frame.ready.measured.wh
    return {
        "id": frame.frame_id,
        "first_box_id": frame.first_box_id,
        "revision": frame.revision,
        "dataset_id": row.dataset_id,
        "key": frame.key,
        "content_digest": frame.ready.digest,
        "config_id": row.config_id,
        "run_id": row.run_id,
        "box_count": frame.boxes,
        "width": width,
        "height": height,
        "carla_version": annotation.carla_version,
        "map": annotation.map,
        "captured_at": annotation.captured_at,
        "camera": annotation.camera_name,
        "sequence": annotation.sequence,
        "weather": annotation.weather_name,
        "annotation": annotation.raw,
        "created_by": frame.created_by,
        "created_at": frame.created_at,
    }


def _carried(
    session: Session,
    sender: Principal,
    former: Frame,
    frame: NewFrame,
    class_ids: Mapping[str, int],
) -> NewFrame:
    """Carry answers over and audit dropped ones; Forbidden if those are others'."""
    carried, dropped = _carry_answers(session, former, frame, class_ids)
    by_reviewer = Counter(who for _, who in dropped)
    of_others = require_own(sender, by_reviewer, f"replacing frame {frame.key!r}")
    AuditTrail(session, sender).note(
        AuditAction.FRAME_REPLACED,
        frame.key,
        dataset=frame.active.name,
        revision=frame.revision,
        answers=len(dropped),
        of_others=of_others,
    )
    boxes = tuple(dict.fromkeys(source_id for source_id, _ in dropped))
    return replace(
        frame,
        carried=carried,
        answers_set_aside=len(dropped),
        boxes_set_aside=boxes[:MOST_BOXES_SET_ASIDE],
    )


def _carry_answers(
    session: Session, former: Frame, frame: NewFrame, class_ids: Mapping[str, int]
) -> tuple[list[LatestReview], list[tuple[str, str]]]:
    """Repeat the latest answers on boxes of the same class and place in the image.

    Returns the repeated answers, each the first on its new box, and of each answer that
    is dropped the box's id and the reviewer, in order of the boxes: these no longer
    exist, have changed, or have no answer in force. Answers that another person cleared
    or replaced, in any revision, count: otherwise people could remove others' answers
    by clearing them first. Answers that their author has undone do not count.
    """
    reviews = ReviewRepository(session)
    answered = reviews.ever_answered(former.id)
    if not answered:
        return [], []
    latest = LatestAnswers(session).of(box_id for box_id, _, _ in answered)
    annotation = FrameRepository(session).with_id(former.id, annotation=True).annotation
    measured, evidence = frame.ready.measured, frame.ready.measured.evidence
    boxes = measured.annotation.boxes
    index_of = {box.id: index for index, box in enumerate(boxes)}
    names = [evidence.class_names[index] for index in evidence.class_index.tolist()]
    carried: dict[int, LatestReview] = {}
    dropped: dict[int, str] = {}
    for old_id, source_id, class_id in answered:
        review, index = latest[old_id], index_of.get(source_id)
        raw = annotation["boxes"][old_id - former.first_box_id]
        if (
            index is None
            or review.verdict == "clear"
            or class_id != class_ids[names[index]]
            or _geometry(raw, annotation)
            != _geometry(boxes[index].raw, measured.annotation.raw)
        ):
            dropped[old_id] = source_id
            continue
        if review.undoes is not None:  # it repeats one that may be another person's
            review = review._replace(reviewer=reviews.author(old_id, review.revision))
        carried[old_id] = review._replace(
            box_id=frame.first_box_id + index,
            revision=1,
            batch_id=None,
            undoes=None,
            created_at=utc_now(),
        )
    if carried:
        reviews.carry_over(carried)
    answers = reviews.answers_in_force(dropped)
    return list(carried.values()), [(dropped[old], who) for old, who in answers]


def _geometry(
    box: Mapping[str, object], annotation: Mapping[str, object]
) -> dict[str, object]:
    """What determines where a box is in the image: for a 3D box, also the camera."""
    form = {key: box[key] for key in GEOMETRIES if key in box}
    if not form.keys().isdisjoint(FORMS_3D):
        form["camera"] = annotation.get("camera")
    return form


def _count_in_metrics(frames: Sequence[NewFrame]) -> None:
    metrics.FRAMES.inc(len(frames))
    for frame in frames:
        for file in frame.ready.files:
            metrics.FRAME_BYTES.labels(file.kind).inc(file.size_bytes)
    reasons = np.concatenate([frame.decisions.reason for frame in frames])
    metrics.BOXES.inc(len(reasons))
    for number, boxes in enumerate(np.bincount(reasons).tolist()):
        if boxes:
            reason = Reason(number)
            metrics.DECISIONS.labels(reason.verdict.value, reason.label).inc(boxes)


def _decisions(frame: NewFrame) -> list[StoredDecision]:
    measured, config = frame.ready.measured, frame.active.config
    evidence, geometry = measured.evidence, measured.geometry
    if frame.revision > 1:  # rounded as when a stored frame is read
        edges = [
            None if box_edges is None else rounded_edges(box_edges)
            for box_edges in geometry.edges
        ]
        geometry = replace(geometry, edges=edges)
    facts = replace(measured.facts(config), key=frame.key)
    composed = decision_dicts(facts, measured.ids, evidence, frame.decisions, geometry)
    assert evidence.xyxy is not None, "a frame just measured has its rectangles"
    covering: dict[int, str] = {}
    for row in np.flatnonzero(frame.doubts.cause == Cause.COVERED).tolist():
        at = most_covering(evidence.xyxy, evidence.accept_mask, row)
        name = evidence.class_names[evidence.class_index[at]]
        gap = float(evidence.distance[at] - evidence.distance[row])
        covering[row] = covering_words(BoxName(measured.ids[at], name), gap)
    sentences = questions(frame.doubts, evidence, config, frame.decisions, covering)
    decisions = asked_decisions(composed, frame.doubts, sentences)
    active = frame.active.row
    decided = DecidedFrame(
        frame.frame_id, active.run_id, active.config_digest, facts.family
    )
    carried = {answer.box_id: answer for answer in frame.carried}
    masks = evidence.accept_mask.tolist()
    return [
        stored_decision(decision, box_id, decided, mask, carried.get(box_id))
        for decision, box_id, mask in zip(decisions, frame.box_ids, masks, strict=True)
    ]
