"""SQL for looking up stored frames by key; `app.measuring.queries` has refused ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from sqlalchemy import select
from sqlalchemy.orm import Session

from app.db.tables import Frame


class KnownFrame(NamedTuple):
    """The newest revision under a key, and the digest of its content."""

    key: str
    frame_id: int
    digest: str


def known_frames(
    session: Session, dataset_id: int, keys: Sequence[str]
) -> list[KnownFrame]:
    """The frames that are stored under some of these keys; uses the index on keys."""
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
