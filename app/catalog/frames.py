"""Frames by their keys and ids, and frames that were refused."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Final, NamedTuple

from sqlalchemy import ColumnElement, bindparam, delete, func, select
from sqlalchemy.orm import Session

from app.db.base import Repository
from app.db.bulk import run
from app.db.engine import once_committed
from app.db.tables import Frame, Problem, Tally
from app.metrics import REFUSED
from filter_core.errors import FilterError, problem_of

_FRAMES: Final = 20_000
"""Frames that are read together, and the maximum number in a range."""


_FORGET_PROBLEMS: Final = delete(Problem).where(
    Problem.dataset_id == bindparam("dataset"), Problem.key == bindparam("frame")
)


class ProblemRepository(Repository):
    """Rows of `problems`."""

    def forget(self, dataset_id: int, key: str) -> None:
        """Delete the problem of a frame: it was stored or deleted, or has another."""
        run(self._session, _FORGET_PROBLEMS, dataset=dataset_id, frame=key)

    def count(self, dataset_id: int) -> int:
        """How many frames of a dataset were refused and not stored since."""
        rows = select(func.count()).select_from(Problem)
        of_dataset = rows.where(Problem.dataset_id == dataset_id)
        return self._session.scalar(of_dataset) or 0


def note_problem(
    session: Session, dataset_id: int, key: str, error: FilterError
) -> None:
    """Store a frame's refusal, so that people can find out why it is missing."""
    ProblemRepository(session).forget(dataset_id, key)
    stored = dict(problem_of(error))
    stored.pop("title", None)
    session.add(Problem(dataset_id=dataset_id, key=key, error=stored))
    session.flush()
    once_committed(session, REFUSED.inc)


def current_in(dataset_id: int) -> tuple[ColumnElement[bool], ColumnElement[bool]]:
    """Conditions: the newest revisions of a dataset's frames."""
    return Frame.dataset_id == dataset_id, Frame.superseded_at.is_(None)


class KeyRow(NamedTuple):
    """The state of a frame's key: `frame_id` is None if there is no frame."""

    frame_id: int | None
    content_digest: str | None
    has_problem: bool


def key_rows(
    session: Session, dataset_id: int, keys: Collection[str]
) -> dict[str, KeyRow]:
    """The state of each of these keys in a dataset."""
    frames = select(Frame.key, Frame.id, Frame.content_digest).where(
        *current_in(dataset_id), Frame.key.in_(keys)
    )
    refused = select(Problem.key).where(
        Problem.dataset_id == dataset_id, Problem.key.in_(keys)
    )
    stored = {row.key: (row.id, row.content_digest) for row in session.execute(frames)}
    problems = set(session.scalars(refused))
    absent = (None, None)
    return {key: KeyRow(*stored.get(key, absent), key in problems) for key in keys}


def frame_ranges(
    session: Session, dataset_id: int, *, boxes: int
) -> Iterator[tuple[int, int]]:
    """First and last id of ranges that together contain all current frames."""
    after = 0
    frames = select(Frame.id, Frame.box_count).where(*current_in(dataset_id))
    next_frames = frames.order_by(Frame.id).limit(_FRAMES)
    while rows := session.execute(next_frames.where(Frame.id > after)).all():
        held, last = 0, rows[0][0]
        for frame_id, count in rows:
            if held and held + count > boxes:
                break
            held, last = held + count, frame_id
        yield rows[0][0], last
        after = last


def frames_state(session: Session, dataset_id: int) -> tuple[int, int]:
    """A value that changes whenever boxes are added or removed: newest id and count.

    Ids only grow and are never reused. The count is read from the tallies: counting the
    frames of a large dataset would take longer than deciding them.
    """
    newest = (
        select(Frame.id)
        .where(only_in(dataset_id))
        .order_by(Frame.dataset_id.desc(), Frame.id.desc())
        .limit(1)
    )
    boxes = select(func.sum(Tally.boxes)).where(Tally.dataset_id == dataset_id)
    return session.scalar(newest) or 0, session.scalar(boxes) or 0


def frame_before(session: Session, dataset_id: int, frame_id: int) -> int:
    """The id of the frame that was stored before this one; 0 if it was the first.

    Ids of frames are given in turn to all datasets, so that the two may be far apart.
    """
    rows = select(func.max(Frame.id)).where(
        *current_in(dataset_id), Frame.id < frame_id
    )
    return session.scalar(rows) or 0


def only_in(dataset_id: int) -> ColumnElement[bool]:
    """Condition: frames of one dataset, for queries sorted by dataset and then id.

    It is written as a range. With an equality, PostgreSQL sorts by the id alone, and
    may scan the frames of all datasets in order of id.
    """
    return Frame.dataset_id.between(dataset_id, dataset_id)
