"""Boxes of a filter in the order of a queue, as many as are wanted and no scan."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import Final

import numpy as np
from sqlalchemy.orm import Session

from app.repositories.box_filter import BoxFilter
from app.repositories.box_orders import Present
from app.repositories.box_pages import BoxPages
from app.repositories.box_probes import BoxProbes
from app.services.shuffling import Shuffle

MAX_PROBES: Final = 1 << 14
"""Boxes that are asked about one by one before all of a filter are read instead."""
FIRST_PORTION: Final = 256
MAX_PORTION: Final = 4096


@dataclass(frozen=True)
class QueueOrder:
    """How boxes are handed out; `seed` is of the random ones.

    There may be fewer of them than `expected`, but not more.
    """

    name: str
    seed: str
    limit: int
    blocked: Collection[int]
    expected: int
    max_probes: int = MAX_PROBES


def boxes_in_order(
    session: Session, wanted: BoxFilter, present: Present, order: QueueOrder
) -> list[int]:
    """The first boxes of the filter that are not blocked."""
    if not order.limit or not order.expected:
        return []
    if order.name in ("random", "audit"):
        return _shuffled(session, wanted, present, order)
    parts = _by_class(wanted, present) if order.name == "class" else iter([wanted])
    free = (
        box_id
        for part in parts
        for box_id in _by_doubt(session, part, present, order)
        if box_id not in order.blocked
    )
    return list(islice(free, order.limit))


def _by_class(wanted: BoxFilter, present: Present) -> Iterator[BoxFilter]:
    for each in wanted.thresholds:
        chosen = wanted.class_ids is None or each.class_id in wanted.class_ids
        if chosen and each.class_id in present.class_ids:
            yield replace(wanted, class_ids=(each.class_id,))


def _by_doubt(
    session: Session, wanted: BoxFilter, present: Present, order: QueueOrder
) -> Iterator[int]:
    # Those flagged as unsure are spread thinly over all boxes, and have an index of
    # their own, by id.
    sort = "id" if wanted.review == "unsure" else "doubt"
    pages, cursor = BoxPages(session, wanted, present), ""
    while True:
        ids, following = pages.page(sort, cursor, order.limit + 10)
        yield from ids
        if following is None:
            return
        cursor = following


def _shuffled(
    session: Session, wanted: BoxFilter, present: Present, order: QueueOrder
) -> list[int]:
    probes = BoxProbes(session)
    span = probes.span(wanted.dataset_id, present.class_ids)
    if span is None:
        return []
    shuffle = Shuffle(*span, order.seed)
    likely = order.limit * (span[1] - span[0] + 1) // order.expected
    # Toss-ups are few and have an index: passing by all of them is soon quicker.
    most = min(order.max_probes, order.expected) if wanted.toss_up else order.max_probes
    found = [] if likely > most else _probed(probes, wanted, shuffle, order)
    if len(found) >= order.limit:
        return found[: order.limit]
    # The filter selects so few that reading all of them is quicker.
    every = probes.every(wanted)
    in_order = every[np.argsort(shuffle.places_of(every))].tolist()
    free = (box_id for box_id in in_order if box_id not in order.blocked)
    return list(islice(free, order.limit))


def _probed(
    probes: BoxProbes, wanted: BoxFilter, shuffle: Shuffle, order: QueueOrder
) -> list[int]:
    """Boxes found by asking about one after the other, in their random order."""
    found: list[int] = []
    asked = 0
    for portion in shuffle.portions(FIRST_PORTION, 4, MAX_PORTION):
        free = [box_id for box_id in portion if box_id not in order.blocked]
        found += probes.selected(wanted, free)
        asked += len(free)
        if len(found) >= order.limit or asked > order.max_probes:
            break
    return found
