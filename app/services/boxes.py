"""Boxes as they are answered: in lists of any order, and alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy.orm import Session

from app.db.tables import Dataset
from app.errors import NotFound
from app.repositories.box_filter import BoxFilter
from app.repositories.box_pages import BoxPages
from app.repositories.datasets import DatasetRepository
from app.repositories.decisions import DecisionRepository
from app.repositories.frames import FrameRepository
from app.repositories.tallies import TallyRepository
from app.services.decisions import DecisionReader, StoredDecision


@dataclass(frozen=True)
class PageRequest:
    """Which page of a list, and in which order."""

    sort: str
    cursor: str
    limit: int


def list_boxes(
    session: Session, dataset: Dataset, wanted: BoxFilter, page: PageRequest
) -> tuple[list[StoredDecision], str | None]:
    """Decisions of one page, and the cursor of the next."""
    present = TallyRepository(session).present(dataset.id)
    pages = BoxPages(session, wanted, present)
    ids, cursor = pages.page(page.sort, page.cursor, page.limit)
    return DecisionReader(session, dataset).of_boxes(ids), cursor


def describe_box(session: Session, box_id: int) -> StoredDecision:
    """One decision; NotFound for a box that is not current."""
    row = DecisionRepository(session).rows([box_id]).get(box_id)
    if row is None:
        raise NotFound("box", box_id)
    frame = FrameRepository(session).with_id(row.frame_id)
    dataset = DatasetRepository(session).with_id(frame.dataset_id)
    (decision,) = DecisionReader(session, dataset).of_boxes([box_id])
    return decision


class NeighbouredDecision(StoredDecision):
    """A decision, and the boxes of its frame that overlap the box."""

    neighbours: list[int]


def with_neighbours(session: Session, box_id: int) -> NeighbouredDecision:
    """One decision, and which boxes of its frame overlap it."""
    decision = describe_box(session, box_id)
    frame = FrameRepository(session).with_id(decision["frame_id"], annotation=True)
    dataset = DatasetRepository(session).with_id(frame.dataset_id)
    others = DecisionReader(session, dataset).of_frame(frame)
    return {**decision, "neighbours": _overlapping(decision, others)}


def _overlapping(
    decision: StoredDecision, others: Sequence[StoredDecision]
) -> list[int]:
    mine = decision["xyxy"]
    if mine is None:
        return []
    return [
        other["box_id"]
        for other in others
        if other["box_id"] != decision["box_id"]
        and other["xyxy"] is not None
        and _overlap(mine, other["xyxy"])
    ]


def _overlap(a: Sequence[float], b: Sequence[float]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
