"""The queue: which boxes a reviewer gets next, claimed so that nobody else gets them.

The random orders come from a Feistel network (`Shuffle`), a one-to-one mapping from
positions to box ids and back that needs no list. The number of positions is a power of
four; ids beyond the range of a dataset are left out.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from hashlib import blake2b
from itertools import islice
from typing import Final, TypedDict

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from app.boxes.counts import count_boxes, count_in_tallies
from app.boxes.current import TallyRepository
from app.boxes.filter import BoxFilter, BoxProbes, to_filter
from app.boxes.orders import BoxPages, DatasetContents
from app.boxes.queries import LatestAnswers
from app.boxes.reader import DecisionReader
from app.context import ServiceContext
from app.db.base import rfc3339, utc_now
from app.db.tables import Dataset
from app.measuring.queries import DatasetRepository
from app.review.queries import ClaimRepository
from filter_core.types import IntArray
from unghost.wire.boxes import BoxSelection

CLAIM: Final = timedelta(minutes=5)
MOST_CLAIMS: Final = 100
"""Claims of one reviewer in a dataset, so that others get boxes, too. A page has about
a dozen boxes that nobody has answered."""
ANSWERS_PER_SHUFFLE: Final = 64
"""The random order changes after this many answers: otherwise the search for the next
box would begin with all boxes that are answered already."""


@dataclass(frozen=True)
class QueueRequest:
    """A reviewer's request for boxes; `exclude` are boxes that the page has already."""

    reviewer: str
    order: str
    selection: BoxSelection
    limit: int
    exclude: Sequence[int]
    seed: int | None


@dataclass(frozen=True)
class RemainingBoxes:
    """The parts of a queue, in order, and the number of boxes in each."""

    parts: Sequence[BoxFilter]
    counts: Sequence[int]


class QueuePage(TypedDict):
    """A `wire.Queue` whose boxes are dicts."""

    items: Sequence[Mapping[str, object]]
    remaining: int
    unsure: int
    claimed_by_others: int


def remaining_boxes(
    context: ServiceContext, name: str, wanted: QueueRequest
) -> RemainingBoxes:
    """The parts of a queue and their sizes, counted before waiting to write."""
    with context.database.read() as session:
        dataset = DatasetRepository(session).named(name)
        parts = _in_turn(to_filter(session, dataset, _of_queue(wanted)))
        counts = [count_boxes(context, session, dataset, part) for part in parts]
    return RemainingBoxes(parts, counts)


def next_boxes(
    session: Session, dataset: Dataset, wanted: QueueRequest, queue: RemainingBoxes
) -> QueuePage:
    """Claim the next boxes for this reviewer; returns them with the queue's counts.

    Claims over `MOST_CLAIMS` end: kept are those on the boxes that are returned, then
    those on the last of `exclude`, then the newest.
    """
    now = utc_now()
    claims = ClaimRepository(session)
    claims.forget_expired(dataset.id, now)
    held = claims.of_dataset(dataset.id)
    theirs = [box_id for box_id, who in held.items() if who != wanted.reviewer]
    ids = _take(session, dataset, wanted, queue, {*wanted.exclude, *theirs})
    mine = held.keys() - theirs
    in_hand = [box_id for box_id in reversed(wanted.exclude) if box_id in mine]
    renewed = list(dict.fromkeys([*ids, *in_hand]))[:MOST_CLAIMS]
    left = mine.difference(renewed)
    newest_first = [box_id for box_id in held if box_id in left]
    claims.end(newest_first[MOST_CLAIMS - len(renewed) :])
    expires_at = now + CLAIM
    claims.hold(dataset.id, sorted(renewed), wanted.reviewer, expires_at)
    claim = {"expires_at": rfc3339(expires_at)}
    probes, reader = BoxProbes(session), DecisionReader(session, dataset)
    return {
        "items": [
            decision | {"claim": claim}
            for decision in reader.records(reader.read_boxes(ids))
        ],
        "remaining": queue.counts[0],
        "unsure": sum(queue.counts[1:]),
        "claimed_by_others": sum(
            len(probes.selected(part, theirs)) for part in queue.parts
        ),
    }


def _of_queue(wanted: QueueRequest) -> BoxSelection:
    """The filter of the queue: undecided boxes, or decided ones for an audit."""
    selection = wanted.selection
    if selection.review or selection.conflict:
        return selection
    review = "decided" if wanted.order == "audit" else "undecided"
    return selection.model_copy(update={"review": review})


def _in_turn(wanted: BoxFilter) -> list[BoxFilter]:
    """The parts: boxes without an answer first, boxes answered `unsure` last."""
    if wanted.review != "undecided":
        return [wanted]
    return [replace(wanted, review="none"), replace(wanted, review="unsure")]


def _take(
    session: Session,
    dataset: Dataset,
    wanted: QueueRequest,
    queue: RemainingBoxes,
    blocked: set[int],
) -> list[int]:
    tallies = TallyRepository(session)
    alike, contents = tallies.of_dataset(dataset.id), tallies.contents(dataset.id)
    seed = dataset.id if wanted.seed is None else wanted.seed
    answers = LatestAnswers(session).newest_id() // ANSWERS_PER_SHUFFLE
    found: list[int] = []
    for part in queue.parts:
        order = QueueOrder(
            name=wanted.order,
            seed=f"{seed} {answers}",
            limit=wanted.limit - len(found),
            blocked=blocked,
            expected=count_in_tallies(alike, part),
        )
        found += boxes_in_order(session, part, contents, order)
    return found


MAX_PROBES: Final = 1 << 14
"""Boxes that are looked up in random order before all boxes are read instead."""
FIRST_SLICE: Final = 256
MAX_SLICE: Final = 4096


@dataclass(frozen=True)
class QueueOrder:
    """The order in which boxes are claimed; `seed` is for random orders.

    `expected` is an upper bound of the number of boxes.
    """

    name: str
    seed: str
    limit: int
    blocked: Collection[int]
    expected: int
    max_probes: int = MAX_PROBES


def boxes_in_order(
    session: Session, wanted: BoxFilter, contents: DatasetContents, order: QueueOrder
) -> list[int]:
    """The first boxes of the filter that are not blocked."""
    if not order.limit or not order.expected:
        return []
    if order.name in ("random", "audit"):
        return _shuffled(session, wanted, contents, order)
    parts = _by_class(wanted, contents) if order.name == "class" else iter([wanted])
    free = (
        box_id
        for part in parts
        for box_id in _by_doubt(session, part, contents, order)
        if box_id not in order.blocked
    )
    return list(islice(free, order.limit))


def _by_class(wanted: BoxFilter, contents: DatasetContents) -> Iterator[BoxFilter]:
    for each in wanted.thresholds:
        chosen = wanted.class_ids is None or each.class_id in wanted.class_ids
        if chosen and each.class_id in contents.class_ids:
            yield replace(wanted, class_ids=(each.class_id,))


def _by_doubt(
    session: Session, wanted: BoxFilter, contents: DatasetContents, order: QueueOrder
) -> Iterator[int]:
    # Boxes answered `unsure` are rare, and have an index of their own, by id.
    sort = "id" if wanted.review == "unsure" else "doubt"
    pages, cursor = BoxPages(session, wanted, contents), ""
    while True:
        ids, following = pages.page(sort, cursor, order.limit + 10)
        yield from ids
        if following is None:
            return
        cursor = following


def _shuffled(
    session: Session, wanted: BoxFilter, contents: DatasetContents, order: QueueOrder
) -> list[int]:
    probes = BoxProbes(session)
    span = probes.span(wanted.dataset_id, contents.class_ids)
    if span is None:
        return []
    shuffle = Shuffle(*span, order.seed)
    likely = order.limit * (span[1] - span[0] + 1) // order.expected
    # Toss-ups are few and have an index: reading all of them is soon faster.
    most = min(order.max_probes, order.expected) if wanted.toss_up else order.max_probes
    found = [] if likely > most else _probed(probes, wanted, shuffle, order)
    if len(found) >= order.limit:
        return found[: order.limit]
    # The filter selects so few boxes that reading all of them is faster.
    every = probes.every(wanted)
    in_order = every[np.argsort(shuffle.places_of(every))].tolist()
    free = (box_id for box_id in in_order if box_id not in order.blocked)
    return list(islice(free, order.limit))


def _probed(
    probes: BoxProbes, wanted: BoxFilter, shuffle: Shuffle, order: QueueOrder
) -> list[int]:
    """Boxes found by looking up one slice after the other, in random order."""
    found: list[int] = []
    asked = 0
    for part in shuffle.slices(FIRST_SLICE, 4, MAX_SLICE):
        free = [box_id for box_id in part if box_id not in order.blocked]
        found += probes.selected(wanted, free)
        asked += len(free)
        if len(found) >= order.limit or asked > order.max_probes:
            break
    return found


_ROUNDS: Final = 4
_Words = NDArray[np.uint64]


@dataclass(frozen=True)
class Shuffle:
    """The numbers from `low` to `high` in a pseudo-random order of the seed."""

    low: int
    high: int
    seed: str

    @property
    def half_bits(self) -> int:
        """Half the number of bits of a position, which is even."""
        return max(1, ((self.high - self.low).bit_length() + 1) // 2)

    @property
    def places(self) -> int:
        """The number of positions, less than four times that of numbers."""
        return 1 << 2 * self.half_bits

    def slices(self, first: int, growth: int, most: int) -> Iterator[list[int]]:
        """All numbers in order, in slices that grow to `most` positions."""
        start, size = 0, first
        while start < self.places:
            stop = min(start + size, self.places)
            yield self.numbers(np.arange(start, stop, dtype=np.uint64)).tolist()
            start, size = stop, min(size * growth, most)

    def numbers(self, places: _Words) -> IntArray:
        """The numbers at these positions; those beyond `high` are left out."""
        left, right = places >> self._shift, places & self._mask
        for key in self._keys():
            left, right = right, left ^ self._mixed(right, key)
        found = (left << self._shift | right).astype(np.int64) + self.low
        inside: IntArray = found[found <= self.high]
        return inside

    def places_of(self, numbers: IntArray) -> _Words:
        """The positions of these numbers; the inverse of `numbers`."""
        words = (numbers - self.low).astype(np.uint64)
        left, right = words >> self._shift, words & self._mask
        for key in reversed(self._keys()):
            left, right = right ^ self._mixed(left, key), left
        return left << self._shift | right

    @property
    def _shift(self) -> np.uint64:
        shift: np.uint64 = np.uint64(self.half_bits)
        return shift

    @property
    def _mask(self) -> np.uint64:
        mask: np.uint64 = np.uint64((1 << self.half_bits) - 1)
        return mask

    def _keys(self) -> list[np.uint64]:
        digest = blake2b(self.seed.encode(), digest_size=8 * _ROUNDS).digest()
        return list(np.frombuffer(digest, "<u8"))

    def _mixed(self, half: _Words, key: np.uint64) -> _Words:
        # The finaliser of splitmix64: every bit of the key and the half reaches all.
        word = half + key
        word = (word ^ word >> np.uint64(30)) * np.uint64(0xBF58476D1CE4E5B9)
        word = (word ^ word >> np.uint64(27)) * np.uint64(0x94D049BB133111EB)
        mixed: _Words = (word ^ word >> np.uint64(31)) & self._mask
        return mixed
