"""Boxes of a filter: counted, asked about one by one, or all of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from sqlalchemy import func, select, union_all
from sqlalchemy.orm import Session

from app.db.bulk import chunks
from app.db.tables import Box, Decision
from app.repositories.box_filter import BoxFilter
from filter_core.types import IntArray


class BoxProbes:
    """Which boxes a filter selects, asked by id."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def span(self, dataset_id: int, class_ids: Iterable[int]) -> tuple[int, int] | None:
        """The lowest and the highest id of a dataset's boxes; None without boxes."""
        # One look at either end of each class in its index.
        ends = [
            select(end(Decision.box_id)).where(
                Decision.dataset_id == dataset_id, Decision.class_id == class_id
            )
            for class_id in class_ids
            for end in (func.min, func.max)
        ]
        if not ends:
            return None
        rows: Iterable[tuple[int | None]] = self._session.execute(union_all(*ends))
        found = [box_id for (box_id,) in rows if box_id is not None]
        return (min(found), max(found)) if found else None

    def newest_id(self) -> int:
        """The number of the newest box of all datasets; 0 if there is none."""
        return self._session.scalar(select(func.max(Box.id))) or 0

    def count(self, wanted: BoxFilter) -> int:
        """How many boxes the filter selects, by looking at them."""
        rows = select(func.count()).select_from(Decision)
        return self._session.scalar(rows.where(*wanted.conditions())) or 0

    def selected(self, wanted: BoxFilter, box_ids: Sequence[int]) -> list[int]:
        """Those of these boxes that the filter selects, in their order."""
        if not box_ids:
            return []
        conditions = wanted.conditions_by_id()
        found: set[int] = set()
        for chunk in chunks(box_ids):
            rows = select(Decision.box_id).where(
                Decision.box_id.in_(chunk), *conditions
            )
            found.update(self._session.scalars(rows))
        return [box_id for box_id in box_ids if box_id in found]

    def every(self, wanted: BoxFilter) -> IntArray:
        """All boxes of the filter, in no order."""
        # Of toss-ups there are far fewer than of boxes without an answer.
        unanswered = [] if wanted.toss_up else wanted.unanswered()
        rows = select(Decision.box_id).where(*wanted.conditions(), *unanswered)
        return np.fromiter(self._session.scalars(rows), np.int64)
