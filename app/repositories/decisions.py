"""Current decisions: what runs change in them, and the tallies summed from them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from app.db.bulk import Written, chunks, update_rows
from app.db.tables import Box, Decision
from app.errors import NotFound
from app.repositories.box_filter import BoxFilter
from app.repositories.datasets import is_deleted
from filter_core.types import Decisions, Evidence, FloatArray, IntArray


class CurrentRow(NamedTuple):
    """A current decision as it is stored."""

    box_id: int
    frame_id: int
    class_id: int
    reason: int
    toss_up: bool
    large: bool
    review: str | None
    revision: int


class TallyRow(NamedTuple):
    """How many boxes are alike in this."""

    class_id: int
    reason: int
    toss_up: bool
    review: str
    boxes: int


class DecisionRepository:
    """Rows of `decisions`, `flips` and `tallies`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def rows(self, box_ids: Iterable[int]) -> dict[int, CurrentRow]:
        """Current decisions of these boxes, by id."""
        found: dict[int, CurrentRow] = {}
        for chunk in chunks(box_ids):
            found |= self._fetch(Decision.box_id.in_(chunk))
        return found

    def dataset_of(self, box_id: int) -> int:
        """The dataset of a box that has a current decision."""
        rows = select(Decision.dataset_id).where(Decision.box_id == box_id)
        found = self._session.scalar(rows)
        if found is None or is_deleted(self._session, found):
            raise NotFound("box", box_id)
        return found

    def ids_in_dataset(self, box_ids: Iterable[int], dataset_id: int) -> set[int]:
        """Those of these boxes that are current boxes of the dataset."""
        found: set[int] = set()
        for chunk in chunks(box_ids):
            rows = select(Decision.box_id).where(
                Decision.box_id.in_(chunk), Decision.dataset_id == dataset_id
            )
            found.update(self._session.scalars(rows))
        return found

    def selection(self, wanted: BoxFilter, *, limit: int) -> list[int]:
        """Ids of all boxes of a filter, in order, up to a limit."""
        rows = (
            select(Decision.box_id)
            .where(*wanted.conditions())
            .order_by(Decision.box_id)
            .limit(limit)
        )
        return list(self._session.scalars(rows))

    def of_frames(self, frame_ids: Iterable[int]) -> dict[int, CurrentRow]:
        """Current decisions of the boxes of frames."""
        return self._fetch(Decision.frame_id.in_(list(frame_ids)))

    def answered_sources(
        self, frame_ids: Iterable[int]
    ) -> dict[int, list[tuple[str, str | None]]]:
        """The sender's own ids of boxes and their answers, in order, by frame."""
        frames = list(frame_ids)
        found: dict[int, list[tuple[str, str | None]]] = {key: [] for key in frames}
        rows = (
            select(Decision.frame_id, Box.source_id, Decision.review)
            .join(Box, Box.id == Decision.box_id)
            .where(Decision.frame_id.in_(frames))
            .order_by(Decision.box_id)
        )
        for frame_id, source_id, review in self._session.execute(rows):
            found[frame_id].append((source_id, review))
        return found

    def per_frame(self, frame_ids: Sequence[int]) -> dict[int, list[TallyRow]]:
        """Tallies of single frames."""
        review = func.coalesce(Decision.review, "")
        rows = (
            select(
                Decision.frame_id,
                Decision.class_id,
                Decision.reason,
                Decision.toss_up,
                review,
                func.count(),
            )
            .where(Decision.frame_id.in_(frame_ids))
            .group_by(
                Decision.frame_id,
                Decision.class_id,
                Decision.reason,
                Decision.toss_up,
                review,
            )
        )
        found: dict[int, list[TallyRow]] = {key: [] for key in frame_ids}
        for row in self._session.execute(rows):
            found[row[0]].append(TallyRow(row[1], row[2], row[3], row[4], row[5]))
        return found

    def refresh(
        self, box_ids: IntArray, before: Decisions, after: Decisions, written: Written
    ) -> None:
        """Make these the current decisions; `before` are the ones they replace.

        Most changes leave the flags alone. Updating only the reason then spares the
        two partial indexes, which is a third of the cost of a million rows.
        """
        flags = (before.large != after.large) | (before.toss_up != after.toss_up)
        plain = ~flags
        update_rows(
            self._session,
            Decision,
            {
                "box_id": box_ids[plain].tolist(),
                "reason": after.reason[plain].tolist(),
            },
            written,
        )
        update_rows(
            self._session,
            Decision,
            {
                "box_id": box_ids[flags].tolist(),
                "reason": after.reason[flags].tolist(),
                "large": after.large[flags].tolist(),
                "toss_up": after.toss_up[flags].tolist(),
            },
            written,
        )

    def refresh_numbers(
        self, box_ids: IntArray, evidence: Evidence, written: Written
    ) -> None:
        """Copy the numbers that lists sort and filter by."""

        def known(column: FloatArray) -> list[float | None]:
            return [None if value != value else value for value in column.tolist()]

        update_rows(
            self._session,
            Decision,
            {
                "box_id": box_ids.tolist(),
                "match_percent": known(evidence.match_percent),
                "crowding": [value or 0.0 for value in known(evidence.crowding)],
                "distance": known(evidence.distance),
            },
            written,
        )

    def _fetch(self, condition: object) -> dict[int, CurrentRow]:
        rows = (
            select(
                Decision.box_id,
                Decision.frame_id,
                Decision.class_id,
                Decision.reason,
                Decision.toss_up,
                Decision.large,
                Decision.review,
                Decision.revision,
            )
            .where(condition)  # type: ignore[arg-type]  # any condition
            .order_by(Decision.box_id)
        )
        return {row[0]: CurrentRow(*row) for row in self._session.execute(rows)}
