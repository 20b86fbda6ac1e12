"""Ranges of a dataset's frames with about so many boxes: work in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from sqlalchemy import select
from sqlalchemy.orm import Session

from app.db.tables import Frame

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
