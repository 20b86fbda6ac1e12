"""A newer revision of a frame: answers stay with the boxes that did not change."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy.orm import Session

from app.db.base import utc_now
from app.db.tables import Frame
from app.repositories.decisions import DecisionRepository
from app.repositories.frames import FrameRepository
from app.repositories.reviews import ReviewRepository
from app.repositories.tallies import TallyKey, TallyRepository
from app.services.statistics import tallies_of
from filter_core.annotation_types import GEOMETRIES


def retire(session: Session, frame: Frame) -> None:
    """Take a frame's boxes out of every list and count; its history stays."""
    rows = DecisionRepository(session).of_frames([frame.id]).values()
    gone = tallies_of(
        (row.class_id, row.reason, row.toss_up, row.review) for row in rows
    )
    TallyRepository(session).add(
        frame.dataset_id, {key: -boxes for key, boxes in gone.items()}
    )
    FrameRepository(session).supersede(frame)


def carry_reviews(
    session: Session, old: Frame, boxes: Sequence[Mapping[str, Any]]
) -> dict[str, int]:
    """Repeat the latest answers on boxes whose class and geometry are the same.

    Parameters
    ----------
    boxes : sequence of mappings
        Of the new revision: ``id`` (the server's), ``source_id``, ``class_id`` and
        ``raw``, the box as it came.

    Returns
    -------
    dict of str to int
        How many answers in force stay behind, by reviewer: their boxes are gone or
        are others now.
    """
    before = FrameRepository(session).sources(old.id)
    latest = {
        box_id: review
        for box_id, review in ReviewRepository(session)
        .latest(box.id for box in before.values())
        .items()
        if review.verdict != "clear"
    }
    raw_before = old.annotation["boxes"]
    rows = []
    for box in boxes:
        former = before.get(box["source_id"])
        review = latest.get(former.id) if former is not None else None
        if former is None or review is None:
            continue
        if former.class_id == box["class_id"] and _geometry(box["raw"]) == _geometry(
            raw_before[former.id - old.first_box_id]
        ):
            rows.append(
                {
                    "box_id": box["id"],
                    "revision": 1,
                    "verdict": review.verdict,
                    "comment": review.comment,
                    "reviewer": review.reviewer,
                    "batch_id": None,
                    "carried_from": former.id,
                    "created_at": utc_now(),
                }
            )
    if rows:
        ReviewRepository(session).add(rows)
        TallyRepository(session).add(old.dataset_id, _counted_over(session, rows))
    carried = {row["carried_from"] for row in rows}
    return Counter(
        review.reviewer for box_id, review in latest.items() if box_id not in carried
    )


def _counted_over(
    session: Session, reviews: Sequence[Mapping[str, Any]]
) -> dict[TallyKey, int]:
    """From the tallies without an answer to those with it."""
    current = DecisionRepository(session).rows(row["box_id"] for row in reviews)
    changes: dict[TallyKey, int] = {}
    for row in current.values():
        for said, change in (("", -1), (row.review or "", 1)):
            key = TallyKey(row.class_id, row.reason, row.toss_up, said)
            changes[key] = changes.get(key, 0) + change
    return changes


def _geometry(raw: Mapping[str, Any]) -> dict[str, Any]:
    return {key: raw[key] for key in GEOMETRIES if key in raw}
