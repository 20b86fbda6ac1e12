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
from app.repositories.latest_answers import LatestAnswers
from app.repositories.reviews import ReviewRepository
from app.repositories.tallies import TallyKey, TallyRepository
from filter_core.annotation.frame import GEOMETRIES


def retire(session: Session, frame: Frame) -> None:
    """Take a frame's boxes out of every list and count; its history stays."""
    gone = DecisionRepository(session).per_frame([frame.id])[frame.id]
    TallyRepository(session).add(
        frame.dataset_id, {TallyKey(*row[:-1]): -row.boxes for row in gone}
    )
    FrameRepository(session).supersede(frame)


def carry_reviews(
    session: Session, old: Frame, boxes: Sequence[Mapping[str, Any]]
) -> tuple[list[dict[str, Any]], dict[str, int]]:
    """Repeat the latest answers on boxes whose class and geometry are the same.

    Parameters
    ----------
    boxes : sequence of mappings
        Of the new revision: ``id`` (the server's), ``source_id``, ``class_id``,
        ``reason``, ``toss_up`` and ``raw``, the box as it came.

    Returns
    -------
    carried : list of dict
        The repeated answers as rows.
    set_aside : dict of str to int
        How many answers stay behind, by reviewer: their boxes are gone or are others
        now, or have no answer in force. Those count that somebody else cleared or
        answered over, in any revision: else who does so first could do away with other
        people's answers. Those that people took back themselves do not.
    """
    reviews = ReviewRepository(session)
    answered = reviews.answered_boxes(old.id)
    if not answered:
        return [], {}
    latest = LatestAnswers(session).of(former.id for former in answered)
    new = {box["source_id"]: box for box in boxes}
    annotation = FrameRepository(session).with_id(old.id, annotation=True).annotation
    carried: list[dict[str, Any]] = []
    changes: Counter[TallyKey] = Counter()
    left = []
    for former in answered:
        review, box = latest[former.id], new.get(former.source_id)
        raw = annotation["boxes"][former.id - old.first_box_id]
        if (
            box is None
            or review.verdict == "clear"
            or former.class_id != box["class_id"]
            or _geometry(raw) != _geometry(box["raw"])
        ):
            left.append(former.id)
            continue
        carried.append(
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
        before = TallyKey(box["class_id"], box["reason"], box["toss_up"], "")
        changes[before] -= 1
        changes[before._replace(review=review.verdict)] += 1
    if carried:
        reviews.add(carried)
        TallyRepository(session).add(old.dataset_id, changes)
    return carried, reviews.meant_by(left)


def _geometry(raw: Mapping[str, Any]) -> dict[str, Any]:
    return {key: raw[key] for key in GEOMETRIES if key in raw}
