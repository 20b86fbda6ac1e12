"""The history of a box: decisions of runs and answers of people, newest first.

Only changes are stored. Earlier verdicts are computed again: the numbers of a
measurement and the version of a configuration never change, and deciding is pure.
"""

from __future__ import annotations

import json
from datetime import datetime
from typing import Final

import numpy as np
from sqlalchemy.orm import Session

from app.boxes.queries import FrameRepository
from app.catalog.configs import ConfigRepository
from app.catalog.datasets import DatasetRepository
from app.db.base import MAX_ID, MAX_REVISION, filled
from app.db.pages import cursor_after, number_and_id_of_cursor
from app.db.tables import Box, Frame, Review, Run
from app.errors import BadCursor
from app.jobs.queries import job_with_id
from app.measuring.active import config_of
from app.measuring.evidence import to_evidence, unpack_channels, unpack_numbers
from app.measuring.queries import EvidenceRepository
from app.review.queries import ReviewBatches, ReviewRepository
from app.runs.queries import RunRepository
from filter_core.arrays import floats_or_none
from filter_core.decisions.rules import decide
from filter_core.verdicts import Reason
from unghost.wire.boxes import HistoryEntry

_OF_ANSWERS: Final = (
    *("revision", "reviewer", "verdict", "comment", "undoes", "carried_from"),
    *("imported_by", "looked_ms", "chosen_by", "probability"),
)
"""Fields of an answer's entry that are columns of `reviews`."""


def history(
    session: Session, box_id: int, *, limit: int, cursor: str | None = None
) -> tuple[list[HistoryEntry], str | None]:
    """A page of the decisions and answers on a box, newest first, and the next cursor.

    They are in the order in which they were stored, regardless of clocks: answers by
    revision, runs by id, and a run after the answers that existed when it was done.

    The place of an entry in this order is a pair of numbers. That of a run is how many
    answers came before it, and its id; an answer comes after all runs that have as
    many answers before them.
    """
    box = FrameRepository(session).box(box_id)
    frame = FrameRepository(session).with_id(box.frame_id)
    before = (MAX_REVISION, MAX_ID)
    if cursor is not None:
        number, run_id = number_and_id_of_cursor(cursor)
        if number > MAX_REVISION:
            raise BadCursor(cursor)
        before = int(number), run_id
    reviews = ReviewRepository(session)
    # One more than the limit, to find out whether there is a next page.
    answers = reviews.newest_on_box(box_id, before[0], limit + 1)
    entries: list[tuple[tuple[int, int], Review | Run | None]]
    entries = [((answer.revision - 1, MAX_ID), answer) for answer in answers]
    so_far = 0
    for run in RunRepository(session).with_flips_of(frame.dataset_id, box_id):
        so_far = max(so_far, reviews.answers_before(box_id, run))
        entries.append(((so_far, run.id), run))
    entries.append(((0, 0), None))
    entries.sort(key=lambda entry: entry[0], reverse=True)
    rest = [entry for entry in entries if entry[0] < before]
    following = cursor_after(*rest[limit - 1][0]) if len(rest) > limit else None
    return [_entry(session, box, frame, row) for _, row in rest[:limit]], following


def _entry(
    session: Session, box: Box, frame: Frame, row: Review | Run | None
) -> HistoryEntry:
    """An answer, the decision of a run, or (None) the first decision."""
    if isinstance(row, Review):
        size, looked_at = None, None
        if row.batch_id is not None:
            batches = ReviewBatches(session)
            size = batches.size(row.batch_id)
            looked_at = batches.with_id(row.batch_id).looked_at
        return HistoryEntry(
            kind="review",
            at=row.created_at,
            batch=row.batch_id,
            batch_size=size,
            looked_at=looked_at,
            chosen_from=json.loads(row.chosen_from or "null"),
            **{name: getattr(row, name) for name in _OF_ANSWERS},
        )
    if row is None:
        by, at = (frame.run_id, frame.config_id), frame.created_at
        return _decision(session, box, frame, by, at)
    by, at = (row.id, row.config_id), row.finished_at or row.created_at
    return _decision(session, box, frame, by, at, activated=row.activate)


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
    rows = EvidenceRepository(session).of_frames([frame.id], filled(run.measurement_id))
    entry: dict[str, object] = {
        "run": run_id,
        "config": version.digest,
        "verdict": None,
        "reason": None,
        "match_percent": None,
        "threshold": None,
    }
    if frame.id not in rows:
        return HistoryEntry(kind="decision", at=at, **entry, **more)
    row = rows[frame.id]
    numbers = unpack_numbers([row.numbers], [row.box_count])
    channels = unpack_channels([row.channels], [row.box_count])
    place = np.array([box.id - frame.first_box_id])
    evidence = to_evidence(numbers, classes, channels=channels).take(place)
    decided = decide(evidence, config_of(version))
    reason = Reason(int(decided.reason[0]))
    entry |= {
        "verdict": reason.verdict.value,
        "reason": reason.label,
        "match_percent": floats_or_none(evidence.shown_match())[0],
        "threshold": floats_or_none(decided.threshold)[0],
    }
    return HistoryEntry(kind="decision", at=at, **entry, **more)
