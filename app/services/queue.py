"""The queue: which boxes a reviewer looks at next, and nobody else meanwhile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from typing import Any, Final

from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.db.base import rfc3339, utc_now
from app.db.tables import Dataset
from app.repositories.box_filter import BoxFilter
from app.repositories.box_probes import BoxProbes
from app.repositories.claims import ClaimRepository
from app.repositories.datasets import DatasetRepository
from app.repositories.latest_answers import LatestAnswers
from app.repositories.tallies import TallyRepository
from app.services.box_counts import count_alike, count_boxes
from app.services.box_selection import Selection, to_filter
from app.services.decisions import DecisionReader
from app.services.queue_order import QueueOrder, boxes_in_order

CLAIM: Final = timedelta(minutes=5)
ANSWERS_PER_SHUFFLE: Final = 64
"""The random order is drawn anew after so many answers: else those who ask for the next
box would be led past all that were answered before."""


@dataclass(frozen=True)
class QueueRequest:
    """Who asks for which boxes, in which order; `exclude` are in the page already."""

    reviewer: str
    order: str
    selection: Selection
    limit: int
    exclude: Sequence[int]
    seed: int | None


@dataclass(frozen=True)
class Outlook:
    """What is queued, part after part, and how many boxes each of them has."""

    parts: Sequence[BoxFilter]
    counts: Sequence[int]


def outlook(context: ServiceContext, name: str, wanted: QueueRequest) -> Outlook:
    """What there is to look at in a dataset; counting keeps nobody from writing."""
    with context.database.read() as session:
        dataset = DatasetRepository(session).named(name)
        parts = _in_turn(to_filter(session, dataset, _of_queue(wanted)))
        counts = [count_boxes(context, session, dataset, part) for part in parts]
    return Outlook(parts, counts)


def next_boxes(
    session: Session, dataset: Dataset, wanted: QueueRequest, queue: Outlook
) -> dict[str, Any]:
    """Boxes claimed for this reviewer, and how many there are."""
    now = utc_now()
    claims = ClaimRepository(session)
    claims.forget_expired(dataset.id, now)
    held = claims.of_dataset(dataset.id)
    theirs = [box_id for box_id, who in held.items() if who != wanted.reviewer]
    ids = _take(session, dataset, wanted, queue, {*wanted.exclude, *theirs})
    in_hand = (held.keys() - theirs) & set(wanted.exclude)
    expires_at = now + CLAIM
    claims.hold(dataset.id, sorted(in_hand.union(ids)), wanted.reviewer, expires_at)
    claim = {"expires_at": rfc3339(expires_at)}
    probes = BoxProbes(session)
    return {
        "items": [
            decision | {"claim": claim}
            for decision in DecisionReader(session, dataset).of_boxes(ids)
        ],
        "remaining": queue.counts[0],
        "unsure": sum(queue.counts[1:]),
        "claimed_by_others": sum(
            len(probes.selected(part, theirs)) for part in queue.parts
        ),
    }


def _of_queue(wanted: QueueRequest) -> Selection:
    """What is queued unless said otherwise: what nobody has decided, or has."""
    selection = wanted.selection
    if selection.review or selection.conflict:
        return selection
    review = "decided" if wanted.order == "audit" else "undecided"
    return replace(selection, review=review)


def _in_turn(wanted: BoxFilter) -> list[BoxFilter]:
    """What nobody answered comes first, what somebody was unsure about last."""
    if wanted.review != "undecided":
        return [wanted]
    return [replace(wanted, review="none"), replace(wanted, review="unsure")]


def _take(
    session: Session,
    dataset: Dataset,
    wanted: QueueRequest,
    queue: Outlook,
    blocked: set[int],
) -> list[int]:
    tallies = TallyRepository(session)
    alike, present = tallies.of_dataset(dataset.id), tallies.present(dataset.id)
    seed = dataset.id if wanted.seed is None else wanted.seed
    answers = LatestAnswers(session).newest_id() // ANSWERS_PER_SHUFFLE
    found: list[int] = []
    for part in queue.parts:
        order = QueueOrder(
            name=wanted.order,
            seed=f"{seed} {answers}",
            limit=wanted.limit - len(found),
            blocked=blocked,
            expected=count_alike(alike, part),
        )
        found += boxes_in_order(session, part, present, order)
    return found
