"""The queue: which boxes a reviewer gets next, claimed so that nobody else gets them.

A claim keeps how its box was chosen; the answer that ends the claim takes this over.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from itertools import islice
from typing import Final, TypeAlias

import numpy as np
from sqlalchemy.orm import Session

from app.boxes.counts import count_boxes, count_in_tallies
from app.boxes.current import TallyRepository
from app.boxes.filter import BoxFilter, BoxProbes, TallyKey, filters_of, to_filter
from app.boxes.orders import BoxPages
from app.boxes.reader import DecisionReader
from app.boxes.shuffle import HALF_BITS, Shuffle, shuffle_of
from app.catalog.datasets import DatasetRepository
from app.context import ServiceContext
from app.db.base import rfc3339, utc_now
from app.db.tables import Dataset
from app.review.queries import ClaimRepository
from filter_core.decisions.doubt import Bin
from filter_core.verdicts import Reason
from unghost.wire.boxes import QueueIn

CLAIM: Final = timedelta(minutes=5)
MOST_CLAIMS: Final = 100
"""Claims of one reviewer in a dataset, so that others get boxes, too. A page has about
a dozen boxes that nobody has answered."""


_Queue: TypeAlias = "list[tuple[BoxFilter, int]]"
"""The parts of a queue, in order, each with the number of its boxes."""


def count_queue(
    context: ServiceContext, name: str, reviewer: str, request: QueueIn
) -> _Queue:
    """The parts of a queue, in order, with how many boxes each has.

    Called before the first statement of a session that writes, which may have to wait:
    counting may take long.
    """
    selection = request.filters
    if not (selection.review or selection.conflict):
        # Undecided boxes, or decided ones for an audit. Without any filter, orders that
        # are not samples have the boxes to ask about.
        review = "decided" if request.order == "audit" else "undecided"
        asks = request.order in ("doubt", "class") and not filters_of(selection)
        bin_ = Bin.ASK.label if asks else selection.bin
        selection = selection.model_copy(update={"review": review, "bin": bin_})
    with context.database.read() as session:
        dataset = DatasetRepository(session).named(name)
        parts = [to_filter(session, dataset, selection)]
        if selection.review == "undecided":  # boxes answered `unsure` come last
            parts = [replace(parts[0], review=state) for state in ("none", "unsure")]
        if request.order == "audit":
            parts = [replace(part, not_by=reviewer) for part in parts]
            return [(part, BoxProbes(session).count(part)) for part in parts]
        return [(part, count_boxes(context, session, dataset, part)) for part in parts]


def next_boxes(
    session: Session, dataset: Dataset, reviewer: str, request: QueueIn, queue: _Queue
) -> dict[str, object]:
    """Claim the next boxes for this reviewer; returns them with the queue's counts.

    They are a `wire.Queue` whose boxes are dicts. Claims over `MOST_CLAIMS` end: kept
    are those on the boxes that are returned, then those on the last of `exclude`, which
    the page has already, then the newest.
    """
    now = utc_now()
    claims = ClaimRepository(session)
    claims.forget_expired(dataset.id, now)
    held = claims.of_dataset(dataset.id)
    theirs = [box_id for box_id, who in held.items() if who != reviewer]
    tallies = TallyRepository(session).of_dataset(dataset.id)
    ids: list[int] = []
    for part, boxes in queue:
        order = QueueOrder(
            name=request.order,
            seed=str(dataset.id if request.seed is None else request.seed),
            limit=request.limit - len(ids),
            blocked={*request.exclude, *theirs},
            expected=min(boxes, count_in_tallies(tallies, part)),
        )
        ids += boxes_in_order(session, part, tallies, order)
    own = held.keys() - theirs
    in_hand = [box_id for box_id in reversed(request.exclude) if box_id in own]
    renewed = list(dict.fromkeys([*ids, *in_hand]))[:MOST_CLAIMS]
    left = own.difference(renewed)
    newest_first = [box_id for box_id in held if box_id in left]
    claims.end(newest_first[MOST_CLAIMS - len(renewed) :])
    expires_at = now + CLAIM
    claims.renew(renewed, expires_at)
    probabilities = _probabilities(session, dataset, request, queue[0][0], ids)
    claims.hold(dataset.id, reviewer, expires_at, request, probabilities)
    claim = {"expires_at": rfc3339(expires_at)}
    probes, reader = BoxProbes(session), DecisionReader(session, dataset)
    return {
        "items": [
            decision | {"claim": claim}
            for decision in reader.records(reader.read_boxes(ids))
        ],
        "remaining": queue[0][1],
        "unsure": sum(boxes for _, boxes in queue[1:]),
        "claimed_by_others": sum(
            len(probes.selected(part, theirs)) for part, _ in queue
        ),
    }


def _probabilities(
    session: Session,
    dataset: Dataset,
    request: QueueIn,
    part: BoxFilter,
    box_ids: Sequence[int],
) -> dict[int, float | None]:
    """That of each of these boxes, if they are a sample; `part` is the queue's first.

    See `ClaimRepository.hold`.
    """
    of_classes = BoxFilter(
        part.dataset_id,
        reasons=part.reasons,
        class_ids=part.class_ids,
        review="none",
        thresholds=part.thresholds,
    )
    judged = {int(reason) for reason in Reason if reason.in_image}
    has_all = part == of_classes and judged.issubset(part.reasons or judged)
    # If the queue has every unanswered box of its classes that people can judge, those
    # that come up to any place of the random order are a sample of these.
    if request.order != "random" or request.seed is not None or not has_all:
        return dict.fromkeys(box_ids)
    shuffle = shuffle_of(session, dataset.id)
    shares = shuffle.shares_of(np.array(box_ids, np.int64)).tolist() if shuffle else []
    return dict(zip(box_ids, shares, strict=True))


MAX_PROBES: Final = 1 << 14
"""Boxes that are looked up in random order before all boxes are read instead."""
FIRST_SLICE: Final = 256
MAX_SLICE: Final = 4096
MAX_PLACES: Final = 1 << 23
PLACES_PER_BOX: Final = 64
"""Places of the random order that are searched: reading a box from the database takes
as long as computing the ids at about so many."""


@dataclass(frozen=True)
class QueueOrder:
    """The order in which boxes are claimed; `seed` is for random orders.

    `expected` is about how many boxes there are, at most; `half_bits` is a lower bound
    of half the bits of a place in random orders.
    """

    name: str
    seed: str
    limit: int
    blocked: Collection[int]
    expected: int
    half_bits: int = HALF_BITS


_Tallies: TypeAlias = Mapping[TallyKey, int]


def boxes_in_order(
    session: Session, box_filter: BoxFilter, tallies: _Tallies, order: QueueOrder
) -> list[int]:
    """The first boxes of the filter that are not blocked."""
    if not order.limit or not order.expected:
        return []
    if order.name in ("random", "audit"):
        return _shuffled(session, box_filter, tallies, order)
    parts = [box_filter]
    if order.name == "class":
        occurring = {key.class_id for key in tallies}
        if box_filter.class_ids is not None:
            occurring &= {*box_filter.class_ids}
        ids = [each.class_id for each in box_filter.thresholds]
        parts = [
            replace(box_filter, class_ids=(id_,)) for id_ in ids if id_ in occurring
        ]
    free = (
        box_id
        for part in parts
        for box_id in _by_doubt(session, part, tallies, order)
        if box_id not in order.blocked
    )
    return list(islice(free, order.limit))


def _by_doubt(
    session: Session, box_filter: BoxFilter, tallies: _Tallies, order: QueueOrder
) -> Iterator[int]:
    # Boxes answered `unsure` are rare, and have an index of their own, by id.
    sort = "id" if box_filter.review == "unsure" else "doubt"
    pages = BoxPages(session, box_filter, tallies, order.expected)
    cursor: str | None = ""
    while cursor is not None:
        ids, cursor = pages.page(sort, cursor, order.limit + 10)
        yield from ids


def _shuffled(
    session: Session, box_filter: BoxFilter, tallies: _Tallies, order: QueueOrder
) -> list[int]:
    probes = BoxProbes(session)
    span = probes.span(box_filter.dataset_id, {key.class_id for key in tallies})
    if span is None:
        return []
    shuffle = Shuffle(*span, order.seed, order.half_bits)
    most = min(MAX_PLACES, PLACES_PER_BOX * order.expected)
    likely = order.limit * shuffle.places // order.expected
    if likely <= most:  # look up one slice after the other, in random order
        box_ids: list[int] = []
        lookups = 0
        for part in shuffle.slices(FIRST_SLICE, 4, MAX_SLICE, most):
            free = [box_id for box_id in part if box_id not in order.blocked]
            box_ids += probes.selected(box_filter, free)
            lookups += len(free)
            if len(box_ids) >= order.limit:
                return box_ids[: order.limit]
            if lookups > MAX_PROBES:
                break
    # The filter selects so few boxes that reading all of them is faster.
    every = probes.every(box_filter)
    in_order = every[np.argsort(shuffle.places_of(every))].tolist()
    unclaimed = (box_id for box_id in in_order if box_id not in order.blocked)
    return list(islice(unclaimed, order.limit))
