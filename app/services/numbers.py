"""The numbers of a whole dataset as columns: what previews and runs decide on.

A million boxes are decided in milliseconds once their numbers are in memory. They are
loaded when first needed, kept while they fit, and loaded anew when frames came or went.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from app.db.evidence_record import to_evidence, unpack_channels, unpack_numbers
from app.repositories.datasets import DatasetRepository
from app.repositories.evidence import EvidenceRepository
from app.repositories.frame_ranges import frame_ranges, frames_state
from app.services.counting import match_counts
from filter_core.config.filter import FilterConfig
from filter_core.decisions.rules import decide
from filter_core.types import Decisions, Evidence, IntArray

MAX_CACHED_BOXES: Final = 8_000_000
"""About 100 bytes each."""
PARTS: Final = 16
"""A larger dataset is worked through in parts of this fraction of it."""
MAX_KEPT_COUNTS: Final = 64
"""Filters whose number of boxes is kept: the queue and lists ask again and again."""


@dataclass(frozen=True)
class DatasetNumbers:
    """Evidence of all current boxes of a dataset, in the order of their ids.

    Not `complete`: some frames are not measured yet, and will be in the same `state`.
    """

    state: tuple[int, int]
    complete: bool
    box_ids: IntArray
    frame_ids: IntArray
    class_ids: IntArray
    evidence: Evidence
    _known: dict[str, Any] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.box_ids)

    def decided(self, config: FilterConfig) -> Decisions:
        """Decisions of the configuration asked for last, such as the active one."""
        held: tuple[str, Decisions] | None = self._known.get("decided")
        if held is None or held[0] != config.digest:
            held = (config.digest, decide(self.evidence, config))
            self._known["decided"] = held
        return held[1]

    def counted(self, what: Hashable, count: Callable[[], int]) -> int:
        """A count of these numbers, kept for whoever asks for the same again."""
        held: OrderedDict[Hashable, int] = self._known.setdefault(
            "counts", OrderedDict()
        )
        found = held.get(what)
        if found is None:
            found = held[what] = count()
            while len(held) > MAX_KEPT_COUNTS:
                held.popitem(last=False)
        return found

    def match_counts(self, bins: int) -> IntArray:
        """Counts of matches per class; thresholds do not change them."""
        held: tuple[int, IntArray] | None = self._known.get("match_counts")
        if held is None or held[0] != bins:
            held = (bins, match_counts(self.evidence, bins))
            self._known["match_counts"] = held
        return held[1]


class NumbersCache:
    """Columns of the datasets used last."""

    def __init__(self, max_boxes: int = MAX_CACHED_BOXES) -> None:
        self._max_boxes = max_boxes
        self._held: OrderedDict[tuple[int, int], DatasetNumbers] = OrderedDict()
        self._lock = threading.Lock()

    def load(
        self, session: Session, dataset_id: int, measurement_id: int
    ) -> DatasetNumbers:
        """The numbers as this session sees them."""
        key = (dataset_id, measurement_id)
        state = frames_state(session, dataset_id)
        with self._lock:
            held = self._held.get(key)
            if held is not None and held.state == state:
                self._held.move_to_end(key)
                return held
        loaded = load_numbers(session, dataset_id, measurement_id, state)
        if loaded.complete:
            self._hold(key, loaded)
        return loaded

    def fits(self, session: Session, dataset_id: int) -> bool:
        """Whether the numbers of a dataset may be held in memory as a whole."""
        return frames_state(session, dataset_id)[1] <= self._max_boxes

    def parts(
        self, session: Session, dataset_id: int, *measurement_ids: int
    ) -> Iterator[tuple[DatasetNumbers, ...]]:
        """A dataset's numbers under each measurement, at least one part of it.

        As a whole if they may be held in memory, in ranges of frames else: those that
        are measured under one of them only are in that one's part. Whoever counts part
        by part needs no more memory for a hundred million boxes than for eight.
        """
        if self.fits(session, dataset_id):
            yield tuple(self.load(session, dataset_id, id_) for id_ in measurement_ids)
            return
        boxes = max(1, self._max_boxes // PARTS)
        for frames in frame_ranges(session, dataset_id, boxes=boxes):
            found = {
                id_: load_numbers(session, dataset_id, id_, frames=frames)
                for id_ in set(measurement_ids)
            }
            yield tuple(found[id_] for id_ in measurement_ids)

    def _hold(self, key: tuple[int, int], loaded: DatasetNumbers) -> None:
        with self._lock:
            self._held.pop(key, None)
            if len(loaded) > self._max_boxes:
                return
            self._held[key] = loaded
            while sum(map(len, self._held.values())) > self._max_boxes:
                self._held.popitem(last=False)


def load_numbers(
    session: Session,
    dataset_id: int,
    measurement_id: int,
    state: tuple[int, int] = (0, 0),
    *,
    frames: tuple[int, int] | None = None,
) -> DatasetNumbers:
    """Read them from the database: all, or those of frames from one id to another."""
    rows = EvidenceRepository(session).numbers(
        dataset_id, measurement_id, frames=frames
    )
    counts = np.array([row.box_count for row in rows], np.int64)
    record = unpack_numbers([row.numbers for row in rows], counts.tolist())
    classes = DatasetRepository(session).classes(dataset_id)
    firsts = np.array([row.first_box_id for row in rows], np.int64)
    return DatasetNumbers(
        state=state,
        complete=int(counts.sum()) == state[1],
        box_ids=_consecutive(firsts, counts),
        frame_ids=np.repeat(np.array([row.frame_id for row in rows], np.int64), counts),
        class_ids=record["class_id"].astype(np.int64),
        evidence=replace(
            to_evidence(record, list(classes), list(classes.values())),
            channels=unpack_channels([row.channels for row in rows], counts.tolist()),
        ),
    )


def _consecutive(firsts: IntArray, counts: IntArray) -> IntArray:
    """``first, first + 1, ...`` per frame, one after the other."""
    total = int(counts.sum())
    starts = np.cumsum(counts) - counts
    within: NDArray[np.int64] = np.arange(total) - np.repeat(starts, counts)
    return np.repeat(firsts, counts) + within
