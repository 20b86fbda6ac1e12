"""The history of a box: decisions of runs and answers of people, newest first.

Only changes are stored. Earlier verdicts are computed again: the numbers of a
measurement and the version of a configuration never change, and deciding is pure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime

import numpy as np
from sqlalchemy.orm import Session

from app.boxes.queries import FrameRepository
from app.db.base import filled
from app.db.tables import Box, Frame, Review, Run
from app.jobs.queries import job_with_id
from app.measuring.active import config_of
from app.measuring.evidence import to_evidence, unpack_channels, unpack_numbers
from app.measuring.queries import (
    ConfigRepository,
    DatasetRepository,
    EvidenceRepository,
    EvidenceRow,
)
from app.review.queries import ReviewRepository
from app.runs.queries import RunRepository
from filter_core.decisions.rules import decide
from filter_core.types import Evidence, Reason, floats_or_none
from unghost.wire.boxes import HistoryEntry


def history(session: Session, box_id: int) -> list[HistoryEntry]:
    """All decisions and answers on a box, newest first.

    They are in the order in which they were stored, regardless of clocks: answers by
    revision, runs by id, and a run after the answers that existed when it was done.
    """
    box = FrameRepository(session).box(box_id)
    frame = FrameRepository(session).with_id(box.frame_id)
    reviews = ReviewRepository(session).of_box(box_id)
    entries = [_first_decision(session, box, frame)]
    told = 0
    for run in RunRepository(session).with_flips_of(frame.dataset_id, box_id):
        found = max(told, _answers_before(run, reviews))
        entries += [_answer(review) for review in reviews[told:found]]
        told = found
        at = run.finished_at or run.created_at
        by = (run.id, run.config_id)
        entry = _decision(session, box, frame, by, at, activated=run.activate)
        entries.append(entry)
    entries += [_answer(review) for review in reviews[told:]]
    return entries[::-1]


def _answers_before(run: Run, reviews: Sequence[Review]) -> int:
    """How many of a box's answers existed when a run was done."""
    if run.last_review_id is not None:
        last = run.last_review_id
        return sum(review.id <= last for review in reviews)
    # A run of an earlier version has only its time.
    at = run.finished_at or run.created_at
    return sum(review.created_at <= at for review in reviews)


def _first_decision(session: Session, box: Box, frame: Frame) -> HistoryEntry:
    return _decision(
        session, box, frame, (frame.run_id, frame.config_id), frame.created_at
    )


def _decision(
    session: Session,
    box: Box,
    frame: Frame,
    by: tuple[int, int],
    at: datetime,
    **more: bool,
) -> HistoryEntry:
    run_id, config_id = by
    version = ConfigRepository(session).with_id(config_id)
    run = job_with_id(session, Run, run_id)
    classes = DatasetRepository(session).classes(frame.dataset_id)
    row = EvidenceRepository(session).of_frames([frame.id], filled(run.measurement_id))
    entry: dict[str, object] = {
        "run": run_id,
        "config": version.digest,
        "verdict": None,
        "reason": None,
        "match_percent": None,
        "threshold": None,
    }
    if frame.id not in row:
        return HistoryEntry(kind="decision", at=at, **entry, **more)
    evidence = _evidence(row[frame.id], classes).take(
        np.array([box.id - frame.first_box_id])
    )
    decided = decide(evidence, config_of(version))
    reason = Reason(int(decided.reason[0]))
    entry |= {
        "verdict": reason.verdict.value,
        "reason": reason.label,
        "match_percent": floats_or_none(evidence.shown_match())[0],
        "threshold": floats_or_none(decided.threshold)[0],
    }
    return HistoryEntry(kind="decision", at=at, **entry, **more)


def _evidence(row: EvidenceRow, classes: Mapping[str, int]) -> Evidence:
    """A frame's numbers, including those of its channels."""
    numbers = unpack_numbers([row.numbers], [row.box_count])
    channels = unpack_channels([row.channels], [row.box_count])
    return to_evidence(numbers, classes, channels=channels)


def _answer(review: Review) -> HistoryEntry:
    return HistoryEntry(
        kind="review",
        at=review.created_at,
        revision=review.revision,
        reviewer=review.reviewer,
        verdict=review.verdict,
        comment=review.comment,
        batch=review.batch_id,
        undoes=review.undoes,
        carried_from=review.carried_from,
    )
