"""The boxes by which people who are new to a dataset learn to answer.

An instance image tells the truth about each: its object is seen, or it is a ghost.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, TypeAlias

from sqlalchemy.orm import Session

from app.boxes.current import TallyRepository
from app.boxes.filter import to_filter
from app.boxes.orders import BoxPages
from app.boxes.reader import DecisionReader, StoredDecision
from app.db.tables import Dataset
from app.review.queries import ReviewRepository
from unghost.wire.boxes import BoxSelection

_AMONG: Final = 2000
"""The first so many boxes of a dataset are looked at."""
_LEAST_SIDE: Final = 16.0
"""Pixels of the shorter side, so that an eye can decide."""
_LEAST_SEEN: Final = 60
"""Pixels of an object that is seen. Between none and these, an eye cannot decide."""


def coached_boxes(
    session: Session, dataset: Dataset, reviewer: str
) -> Sequence[StoredDecision]:
    """Five boxes whose truth is known, each harder than the one before.

    None if the dataset coaches nobody, if the reviewer has answered another box of it,
    or if it has no five such boxes.
    """
    if not dataset.coached:
        return []
    everything = to_filter(session, dataset, BoxSelection())
    tallies = TallyRepository(session).of_dataset(dataset.id)
    ids, _ = BoxPages(session, everything, tallies).page("id", None, _AMONG)
    reader = DecisionReader(session, dataset)
    boxes = [box for box in reader.records(reader.read_boxes(ids)) if _is_certain(box)]
    lesson: list[StoredDecision] = []
    for kinds in _LESSON:
        left = [box for box in boxes if box not in lesson]
        choices = next(filter(None, ([*filter(is_one, left)] for is_one in kinds)), [])
        # A new picture teaches more.
        frames = {box["frame_id"] for box in lesson}
        lesson += sorted(choices, key=lambda box: box["frame_id"] in frames)[:1]
    taught = [box["box_id"] for box in lesson]
    answers = ReviewRepository(session)
    if len(lesson) < len(_LESSON) or answers.has_answered_beyond(
        dataset.id, reviewer, taught
    ):
        return []
    return lesson


def _is_certain(box: StoredDecision) -> bool:
    """Whether an instance image tells the truth about it, and an eye can see it."""
    xyxy, seen = box["xyxy"], box["visible_pixels"]
    if box["evidence"] != "instance" or xyxy is None or seen is None:
        return False
    side = min(xyxy[2] - xyxy[0], xyxy[3] - xyxy[1])
    return side >= _LEAST_SIDE and (seen == 0 or seen >= _LEAST_SEEN)


def _seen_percent(box: StoredDecision) -> float:
    return 100 * (box["visible_pixels"] or 0) / max(box["box_pixels"] or 0, 1)


def _class_percent(box: StoredDecision) -> float:
    """The share of a box that shows objects of its class."""
    return box["match_percent"] or 0.0


def _is_ghost(box: StoredDecision) -> bool:
    return box["visible_pixels"] == 0


def _in_full_view(box: StoredDecision) -> bool:
    return _seen_percent(box) >= 40


_Kind: TypeAlias = Callable[[StoredDecision], bool]
_LESSON: Final[tuple[tuple[_Kind, ...], ...]] = (
    (
        lambda box: _in_full_view(box) and (box["visible_pixels"] or 0) >= 1000,
        _in_full_view,
    ),
    # Behind other things.
    (lambda box: _is_ghost(box) and _class_percent(box) <= 10,),
    # Partly hidden.
    (lambda box: 0 < _seen_percent(box) <= 25,),
    (_is_ghost,),
    # Behind its like: most of what is seen in the box is another object of its class.
    (
        lambda box: _is_ghost(box) and _class_percent(box) >= 50,
        lambda box: 0 < _seen_percent(box) <= 10,
    ),
)
"""Of which kind each box is; a further kind counts where there is none of the first."""
