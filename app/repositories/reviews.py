"""Answers of people: added, never changed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from sqlalchemy import Executable, exists, insert, select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.db.bulk import chunks, update_rows
from app.db.tables import Box, Decision, Review
from app.errors import LostRace


class AnsweredBox(NamedTuple):
    """A box that has got an answer at some time."""

    id: int
    source_id: str
    class_id: int


def insert_answers(
    session: Session, statement: Executable, rows: Sequence[dict[str, Any]] = ()
) -> None:
    """Insert answers, listed or selected by the statement itself.

    Unique (box, revision) settles a race between two people.

    Raises
    ------
    LostRace
        A box has an answer of this revision already.
    """
    try:
        session.connection().execute(statement, rows or None)
    except IntegrityError as error:
        raise LostRace from error


class ReviewRepository:
    """Rows of `reviews`."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def add(self, rows: Sequence[dict[str, Any]]) -> None:
        """Insert answers; LostRace if somebody answered a box at the same moment."""
        insert_answers(self._session, insert(Review), list(rows))
        update_rows(
            self._session,
            Decision,
            {
                "box_id": [row["box_id"] for row in rows],
                "review": [
                    None if row["verdict"] == "clear" else row["verdict"]
                    for row in rows
                ],
                "revision": [row["revision"] for row in rows],
            },
        )

    def of_box(self, box_id: int) -> list[Review]:
        """All answers on a box, oldest first."""
        rows = select(Review).where(Review.box_id == box_id).order_by(Review.revision)
        return list(self._session.scalars(rows))

    def answered_boxes(self, frame_id: int) -> list[AnsweredBox]:
        """Boxes of a frame on which somebody ever answered."""
        rows = (
            select(Box.id, Box.source_id, Box.class_id)
            .where(Box.frame_id == frame_id)
            .where(exists().where(Review.box_id == Box.id))
            .order_by(Box.id)
        )
        return [AnsweredBox(*row) for row in self._session.execute(rows)]

    def meant_by(self, box_ids: Iterable[int]) -> Counter[str]:
        """On how many boxes each person has an answer that they did not take back.

        Whatever others said afterwards, and also where a box came from in the revisions
        before: the last thing that each person said of it.
        """
        last: dict[tuple[int, str], str] = {}
        newest_of = {box_id: box_id for box_id in box_ids}
        while newest_of:
            before: dict[int, int] = {}
            for chunk in chunks(newest_of):
                rows = (
                    select(
                        Review.box_id,
                        Review.reviewer,
                        Review.verdict,
                        Review.carried_from,
                    )
                    .where(Review.box_id.in_(chunk))
                    .order_by(Review.box_id, Review.revision.desc())
                )
                for box_id, reviewer, verdict, origin in self._session.execute(rows):
                    newest = newest_of[box_id]
                    last.setdefault((newest, reviewer), verdict)
                    if origin is not None:
                        before[origin] = newest
            newest_of = before
        return Counter(who for (_, who), verdict in last.items() if verdict != "clear")
