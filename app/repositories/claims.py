"""Claims: which reviewer is looking at which box, until when."""

from __future__ import annotations

from collections.abc import Collection
from datetime import datetime

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from app.db.bulk import chunks, upsert
from app.db.tables import Claim


class ClaimRepository:
    """Rows of `claims`; those that expired are as good as gone."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def forget_expired(self, dataset_id: int, now: datetime) -> None:
        """Delete what holds nobody back any more."""
        self._session.execute(
            delete(Claim).where(Claim.dataset_id == dataset_id, Claim.expires_at <= now)
        )

    def of_dataset(self, dataset_id: int) -> dict[int, str]:
        """Reviewer by box of all claims of a dataset."""
        rows = select(Claim.box_id, Claim.reviewer).where(
            Claim.dataset_id == dataset_id
        )
        return {row[0]: row[1] for row in self._session.execute(rows)}

    def hold(
        self,
        dataset_id: int,
        box_ids: Collection[int],
        reviewer: str,
        expires_at: datetime,
    ) -> None:
        """Claim boxes, or go on claiming them."""
        if not box_ids:
            return
        insert = upsert(self._session, Claim)
        claims = [
            {
                "box_id": box_id,
                "dataset_id": dataset_id,
                "reviewer": reviewer,
                "expires_at": expires_at,
            }
            for box_id in box_ids
        ]
        statement = insert.on_conflict_do_update(
            index_elements=["box_id"],
            set_={
                name: insert.excluded[name]
                for name in ("dataset_id", "reviewer", "expires_at")
            },
        )
        self._session.connection().execute(statement, claims)

    def release(self, dataset_id: int, box_ids: Collection[int]) -> None:
        """Boxes that were answered: nobody has to be kept from them."""
        # Claims are few, and answers may be a hundred thousand.
        held = select(Claim.box_id).where(Claim.dataset_id == dataset_id)
        answered = set(box_ids).intersection(self._session.scalars(held))
        for chunk in chunks(answered):
            self._session.execute(delete(Claim).where(Claim.box_id.in_(chunk)))
