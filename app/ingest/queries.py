"""SQL of frames that are known; refused ones are in `app.measuring.queries`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from sqlalchemy import select
from sqlalchemy.orm import Session

from app.db.tables import Frame


class KnownFrame(NamedTuple):
    """The newest revision under a key, and what names its content."""

    key: str
    frame_id: int
    digest: str


def known_frames(
    session: Session, dataset_id: int, keys: Sequence[str]
) -> list[KnownFrame]:
    """Those of these keys under which there is a frame; by the index on keys."""
    rows = (
        select(Frame.key, Frame.id, Frame.content_digest)
        .where(
            Frame.dataset_id == dataset_id,
            Frame.key.in_(keys),
            Frame.superseded_at.is_(None),
        )
        .order_by(Frame.key)
    )
    return [KnownFrame(*row) for row in session.execute(rows)]
