"""The evidence of all boxes of a dataset as columns in memory, and a cache of it.

A million boxes are decided in milliseconds once their numbers are in memory. They are
loaded on first use, cached while they fit, and reloaded when frames are added or
removed, or classes added or renamed.
"""

from __future__ import annotations

import threading
from collections import Counter, OrderedDict
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from app.catalog.datasets import DatasetRepository
from app.catalog.frames import frame_ranges, frames_state
from app.measuring.evidence import to_evidence, unpack_channels, unpack_numbers
from app.measuring.queries import EvidenceRepository
from filter_core.arrays import FloatArray, IntArray
from filter_core.config.filter import DecideConfig, FilterConfig
from filter_core.decisions.channel_rules import (
    decides,
    own_percent,
    own_pixels,
    pixels_needed,
)
from filter_core.decisions.doubt import doubts
from filter_core.decisions.rules import decide
from filter_core.evidence_kinds import ChannelName
from filter_core.evidence_numbers import Evidence
from filter_core.verdicts import VERDICT_OF_REASON, VERDICTS, Decisions, Reason
from unghost.wire.datasets import Histogram

_MAX_PERCENT: Final = 100.0
_Made = TypeVar("_Made")


def outcome(names: Sequence[str], table: IntArray) -> dict[str, object]:
    """How many boxes got each verdict and reason, altogether and per class."""
    per_reason = table.sum(axis=0)
    verdicts = np.zeros((len(names), len(VERDICTS)), np.int64)
    for reason in Reason:
        verdicts[:, VERDICT_OF_REASON[reason]] += table[:, reason]
    return {
        "counts": _by_verdict(verdicts.sum(axis=0)),
        "by_reason": _by_label(per_reason),
        "by_class": {
            name: _by_verdict(row)
            for name, row in zip(names, verdicts, strict=True)
            if row.any()
        },
        "reasons_by_class": {
            name: _by_label(row)
            for name, row in zip(names, table, strict=True)
            if row.any()
        },
    }


def _by_label(counts: IntArray) -> dict[str, int]:
    """Boxes by the name of their reason, from (reasons,) boxes by its number."""
    labels: Counter[str] = Counter()
    for reason in Reason:
        labels[reason.label] += int(counts[reason])
    return {label: boxes for label, boxes in labels.items() if boxes}


def share_counts(
    evidence: Evidence, channels: tuple[ChannelName, ...], bins: int, needed: IntArray
) -> IntArray:
    """(2, classes, bins): boxes by what is compared, in equal bins from 0 to 100.

    Boxes with fewer visible pixels than `needed`, of each box, but some, are left out:
    they are rejected whatever their share is.

    First those that tags decide, by match_percent; then those that one of the channels
    decides, by the share of their pixels that are their object's own (`own_percent`).
    """
    by_tags = evidence.measured & ~decides(evidence, channels)
    few, few_own = (
        (pixels > 0) & (pixels < needed)
        for pixels in (evidence.matched_pixels, own_pixels(evidence, channels))
    )
    match = np.where(by_tags & ~few, evidence.match_percent, np.nan)
    own = np.where(few_own, np.nan, own_percent(evidence, channels))
    tables = []
    for shares in (match, own):
        # Boxes without a share (outside, degenerate) are in no histogram.
        has_share = shares == shares
        scaled = shares[has_share] * (bins / _MAX_PERCENT)
        bin_of = np.minimum(scaled.astype(np.int32), bins - 1)
        packed = evidence.class_index[has_share] * np.int32(bins) + bin_of
        counts = np.bincount(packed, minlength=len(evidence.class_names) * bins)
        tables.append(counts.reshape(-1, bins))
    return np.stack(tables)


def unknown_pixels(evidence: Evidence) -> FloatArray:
    """(2, classes): pixels of unknown tag or colour, and all, in measured boxes."""
    boxes_px = np.where(evidence.measured, evidence.box_pixels, 0)
    index, classes = evidence.class_index, len(evidence.class_names)
    every = (evidence.unknown_pixels, boxes_px)
    return np.array([np.bincount(index, pixels, classes) for pixels in every])


def histogram(
    names: Sequence[str], counts: IntArray, pixels: FloatArray, limits: FloatArray
) -> Histogram:
    """The counts of classes that occur, with their thresholds.

    `counts` are one of those of `share_counts`, `pixels` those of `unknown_pixels`,
    `limits` (classes,) in percent.
    """
    occurs = np.flatnonzero(counts.sum(axis=1)).tolist()
    return Histogram(
        edges=np.linspace(0.0, _MAX_PERCENT, counts.shape[1] + 1).tolist(),
        classes={names[index]: counts[index].tolist() for index in occurs},
        thresholds={names[index]: float(limits[index]) for index in occurs},
        unknown_percent={
            names[index]: float(100 * pixels[0, index] / pixels[1, index])
            for index in np.flatnonzero(pixels[0]).tolist()
        },
    )


def _by_verdict(counts: IntArray) -> dict[str, int]:
    pairs = zip(VERDICTS, counts, strict=True)
    return {verdict.value: int(count) for verdict, count in pairs}


MAX_CACHED_BOXES: Final = 8_000_000
"""Boxes in the cache, of about 100 bytes each."""
PARTS: Final = 16
"""A larger dataset is processed in parts of 1/16 of the cache's size."""
MAX_KEPT_COUNTS: Final = 64
"""Filters whose count is cached: the queue and lists need them again and again."""


@dataclass(frozen=True)
class DatasetColumns:
    """Evidence of all current boxes of a dataset, in order of id.

    `complete` is False if some frames are not measured yet: measuring them does not
    change `state`.
    """

    state: tuple[int, int]
    complete: bool
    box_ids: IntArray
    frame_ids: IntArray
    class_ids: IntArray
    evidence: Evidence
    _counts: OrderedDict[Hashable, int] = field(default_factory=OrderedDict, repr=False)
    _last: dict[str, tuple[Hashable, Any]] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.box_ids)

    @property
    def names(self) -> tuple[str, ...]:
        """All classes of the dataset in their order, which a rename changes."""
        return self.evidence.class_names

    def _cached(self, what: str, key: Hashable, make: Callable[[], _Made]) -> _Made:
        """The result of `make`; of each kind the last one is cached, under its key."""
        held = self._last.get(what)
        if held is None or held[0] != key:
            held = self._last[what] = (key, make())
        made: _Made = held[1]
        return made

    def decided(self, config: FilterConfig) -> Decisions:
        """Decisions by a configuration; those of the last one are cached."""
        return self._cached(
            "decided", config.digest, lambda: decide(self.evidence, config)
        )

    def doubt(self, config: FilterConfig) -> NDArray[np.int16]:
        """(N,): the doubt about each box (`doubts`); that of the last one is cached."""
        return self._cached(
            "doubt",
            config.digest,
            lambda: doubts(self.evidence, config, self.decided(config)).doubt,
        )

    def counted(self, what: Hashable, count: Callable[[], int]) -> int:
        """The result of `count`, cached under the key `what`."""
        held = self._counts
        if what not in held:
            held[what] = count()
            while len(held) > MAX_KEPT_COUNTS:
                held.popitem(last=False)
        return held[what]

    def share_counts(
        self, channels: tuple[ChannelName, ...], bins: int, config: DecideConfig
    ) -> IntArray:
        """`share_counts` of these boxes, cached; independent of thresholds.

        Of `config` only `min_visible_pixels` counts.
        """
        limits = config.limits_by_class(self.names).min_visible_pixels

        def count() -> IntArray:
            needed = pixels_needed(self.evidence, config)
            return share_counts(self.evidence, channels, bins, needed)

        return self._cached("shares", (channels, bins, limits.tobytes()), count)

    def unknown_pixels(self) -> FloatArray:
        """`unknown_pixels` of these boxes, cached."""
        return self._cached("unknown", None, lambda: unknown_pixels(self.evidence))


class ColumnCache:
    """A cache of the columns of recently used datasets."""

    def __init__(self, max_boxes: int = MAX_CACHED_BOXES) -> None:
        self._max_boxes = max_boxes
        self._held: OrderedDict[tuple[int, int], DatasetColumns] = OrderedDict()
        self._lock = threading.Lock()

    def load(
        self, session: Session, dataset_id: int, measurement_id: int
    ) -> DatasetColumns:
        """The numbers in this session's snapshot."""
        key = (dataset_id, measurement_id)
        state = frames_state(session, dataset_id)
        names = tuple(DatasetRepository(session).classes(dataset_id))
        with self._lock:
            held = self._held.get(key)
            if held is not None and (held.state, held.names) == (state, names):
                self._held.move_to_end(key)
                return held
        loaded = load_columns(session, dataset_id, measurement_id, state)
        if loaded.complete:
            with self._lock:
                self._held.pop(key, None)
                if len(loaded) <= self._max_boxes:
                    self._held[key] = loaded
                while sum(map(len, self._held.values())) > self._max_boxes:
                    self._held.popitem(last=False)
        return loaded

    def fits(self, session: Session, dataset_id: int) -> bool:
        """Whether all numbers of a dataset fit into the cache."""
        return frames_state(session, dataset_id)[1] <= self._max_boxes

    def parts(
        self, session: Session, dataset_id: int, *measurement_ids: int
    ) -> Iterator[tuple[DatasetColumns, ...]]:
        """A dataset's numbers under each measurement, in one or more parts.

        It is one part if they fit into the cache, otherwise one for each range of
        frames. A frame that is measured under one measurement only is in that one's
        columns only. A caller that counts part by part needs no more memory for a
        hundred million boxes than for eight million.
        """
        if self.fits(session, dataset_id):
            yield tuple(self.load(session, dataset_id, id_) for id_ in measurement_ids)
            return
        boxes = max(1, self._max_boxes // PARTS)
        for frames in frame_ranges(session, dataset_id, boxes=boxes):
            part = {
                id_: load_columns(session, dataset_id, id_, frames=frames)
                for id_ in set(measurement_ids)
            }
            yield tuple(part[id_] for id_ in measurement_ids)


def load_columns(
    session: Session,
    dataset_id: int,
    measurement_id: int,
    state: tuple[int, int] = (0, 0),
    *,
    frames: tuple[int, int] | None = None,
) -> DatasetColumns:
    """Read columns from the database, of all frames or of a range of frame ids."""
    rows = EvidenceRepository(session).numbers(
        dataset_id, measurement_id, frames=frames
    )
    counts = np.array([row.box_count for row in rows], np.int64)
    record = unpack_numbers([row.numbers for row in rows], counts.tolist())
    classes = DatasetRepository(session).classes(dataset_id)
    firsts = np.array([row.first_box_id for row in rows], np.int64)
    starts = np.cumsum(counts) - counts
    # The ids of a frame's boxes follow each other.
    box_ids = np.repeat(firsts - starts, counts) + np.arange(int(counts.sum()))
    return DatasetColumns(
        state=state,
        complete=int(counts.sum()) == state[1],
        box_ids=box_ids,
        frame_ids=np.repeat(np.array([row.frame_id for row in rows], np.int64), counts),
        class_ids=record["class_id"].astype(np.int64),
        evidence=to_evidence(
            record,
            classes,
            channels=unpack_channels([row.channels for row in rows], counts.tolist()),
        ),
    )
