"""Ranges of a dataset's frames with about so many boxes: work in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from sqlalchemy import ColumnElement, func, select
from sqlalchemy.orm import Session

from app.db.tables import Frame, Tally

_FRAMES: Final = 20_000
"""Frames that are looked at together, and the most of a range."""


def frame_ranges(
    session: Session, dataset_id: int, *, boxes: int
) -> Iterator[tuple[int, int]]:
    """First and last id of each range; together they are all current frames."""
    after = 0
    while rows := _page(session, dataset_id, after):
        held, last = 0, rows[0][0]
        for frame_id, count in rows:
            if held and held + count > boxes:
                break
            held, last = held + count, frame_id
        yield rows[0][0], last
        after = last


def _page(session: Session, dataset_id: int, after: int) -> list[tuple[int, int]]:
    rows = (
        select(Frame.id, Frame.box_count)
        .where(
            Frame.dataset_id == dataset_id,
            Frame.superseded_at.is_(None),
            Frame.id > after,
        )
        .order_by(Frame.id)
        .limit(_FRAMES)
    )
    return [(row[0], row[1]) for row in session.execute(rows)]


def frames_state(session: Session, dataset_id: int) -> tuple[int, int]:
    """Changes whenever boxes come or go: ids only grow, and are never reused.

    Read from the tallies: counting the frames of a large dataset would take longer
    than deciding them.
    """
    newest = (
        select(Frame.id)
        .where(only_in(dataset_id))
        .order_by(Frame.dataset_id.desc(), Frame.id.desc())
        .limit(1)
    )
    boxes = select(func.sum(Tally.boxes)).where(Tally.dataset_id == dataset_id)
    return session.scalar(newest) or 0, session.scalar(boxes) or 0


def only_in(dataset_id: int) -> ColumnElement[bool]:
    """A dataset as a range of one, for what is in the order of dataset and then id.

    Told the dataset itself, PostgreSQL sees that only the id makes the order, and may
    go through the frames of all datasets by their ids.
    """
    return Frame.dataset_id.between(dataset_id, dataset_id)
