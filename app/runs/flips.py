"""Finds boxes whose verdict differs: by another configuration, or between two runs.

The changes of runs are stored, but any two runs, activated or not, are compared by
deciding again: numbers and configurations never change, and deciding is pure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from app.boxes.truth import KnownTruth, described, places_in
from app.catalog.configs import ConfigRepository
from app.catalog.datasets import DatasetRepository
from app.context import ServiceContext
from app.db.base import filled
from app.db.pages import cursor_after, number_and_id_of_cursor
from app.db.tables import Dataset, Run
from app.errors import BadRequest, Conflict
from app.jobs.queries import job_with_id
from app.measuring.active import active_config, config_of
from app.measuring.columns import (
    ColumnCache,
    DatasetColumns,
    histogram,
    outcome,
    share_counts,
)
from app.measuring.evidence import recount, unpack_numbers
from app.measuring.plan import (
    DatasetReading,
    active_measurement,
    in_version,
    needs_pixels,
    plan_for,
    version_of,
)
from app.measuring.queries import EvidenceRepository
from filter_core.arrays import BoolArray, FloatArray, IntArray, floats_or_none, rows_of
from filter_core.config.file import load_config
from filter_core.config.filter import FilterConfig
from filter_core.config.measure import MeasureConfig
from filter_core.decisions.channel_rules import (
    compared_by_channels,
    own_percent,
    pixels_needed,
)
from filter_core.decisions.rules import decide
from filter_core.evaluation.scores import Confusion
from filter_core.evidence_kinds import CHANNELS, EvidenceName
from filter_core.evidence_numbers import Evidence
from filter_core.verdicts import (
    KEPT,
    REJECTED,
    UNMEASURED,
    VERDICT_OF_REASON,
    VERDICTS,
    Decisions,
    Reason,
)
from unghost.wire import runs as wire
from unghost.wire.boxes import XYXY
from unghost.wire.datasets import Histogram
from unghost.wire.words import FlipCause

_REASONS: Final = len(VERDICT_OF_REASON)
_FLIPS: Final = VERDICT_OF_REASON[:, None] != VERDICT_OF_REASON
"""(reasons, reasons): whether the verdict changes from one reason to another."""


_SIDES: Final[dict[str, BoolArray]] = {
    side: np.outer(before == VERDICT_OF_REASON, after == VERDICT_OF_REASON)
    for side, before, after in (
        ("kept_to_rejected", KEPT, REJECTED),
        ("rejected_to_kept", REJECTED, KEPT),
    )
}
FARTHEST: Final = float("inf")
_KINDS: Final[tuple[EvidenceName, ...]] = ("semantic", *CHANNELS)
"""The kinds of evidence by the number of `Decisions.channel`."""


class FlipTable:
    """Counts boxes of the classes `names` by class, reason before and reason after."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        self._boxes: IntArray = np.zeros((len(names), _REASONS, _REASONS), np.int64)

    def add(
        self,
        evidence: Evidence,
        before: NDArray[np.uint8],
        after: NDArray[np.uint8],
        rows: IntArray | None = None,
    ) -> IntArray:
        """Count boxes, and find those whose verdicts differ.

        `before` and `after` (M,) are the reasons of the boxes in `rows` (M,) of the
        evidence; None for all of them, in order. Returns indexes into `before` and
        `after`, ascending.
        """
        # Two bytes per box and single passes: previews are made while a slider moves.
        changes = before * np.uint16(_REASONS) + after
        index = evidence.class_index if rows is None else evidence.class_index[rows]
        shape = len(evidence.class_names), _REASONS, _REASONS
        cells = index * np.int64(_REASONS * _REASONS)
        cells += changes
        counts = np.bincount(cells, minlength=int(np.prod(shape))).reshape(shape)
        # A part of a dataset may have its classes in another order.
        here = [self.names.index(name) for name in evidence.class_names]
        self._boxes[here] += counts
        return np.flatnonzero(_FLIPS.ravel()[changes])

    @property
    def after(self) -> IntArray:
        """(classes, reasons): boxes by their reason after."""
        table: IntArray = self._boxes.sum(axis=1)
        return table

    @property
    def compared(self) -> int:
        """How many boxes were counted."""
        return int(self._boxes.sum())

    @property
    def changed(self) -> int:
        """How many boxes have another reason."""
        return self.compared - int(self._boxes.trace(axis1=1, axis2=2).sum())

    def verdicts(self) -> dict[str, int]:
        """How many boxes have each verdict after."""
        reasons = self.after.sum(axis=0)
        return {
            verdict.value: int(reasons[code == VERDICT_OF_REASON].sum())
            for code, verdict in enumerate(VERDICTS)
        }

    def flips_by_class(self) -> dict[str, int]:
        """How many boxes of each class have another verdict, if any have."""
        return self._by_class(_FLIPS)

    def directions_by_class(self) -> dict[str, wire.FlipCounts]:
        """How many boxes of each class became kept and rejected, if any did."""
        sides = {side: self._by_class(which) for side, which in _SIDES.items()}
        return {
            name: wire.FlipCounts(
                **{side: of.get(name, 0) for side, of in sides.items()}
            )
            for name in self.names
            if any(name in of for of in sides.values())
        }

    def totals(self) -> dict[str, int]:
        """How many boxes flipped in each direction."""
        return {side: int(self._boxes[:, at].sum()) for side, at in _SIDES.items()}

    def _by_class(self, which: BoolArray) -> dict[str, int]:
        counts = self._boxes[:, which].sum(axis=1).tolist()
        pairs = zip(self.names, counts, strict=True)
        return {name: count for name, count in pairs if count}


class _Nearest:
    """The flips that are nearest to a threshold, which people should look at.

    Equally near ones are in order of box id. `after` is the position of the cursor: a
    distance and a box id.
    """

    def __init__(self, limit: int, after: tuple[float, int] | None = None) -> None:
        self._limit, self._after = limit, after
        self.found: list[tuple[float, int, wire.Flip]] = []

    def add(self, before: _Decided, after: _Decided, flips: IntArray) -> None:
        """Add the nearest among the flips of a part of a dataset."""
        if not self._limit:
            return
        rows = after.rows_of(flips)
        distances: FloatArray = np.nan_to_num(after.margins(rows), nan=FARTHEST)
        ids = after.numbers.box_ids[rows]
        # Boxes come in the order of their ids.
        order = np.argsort(distances, kind="stable")
        if self._after is not None:
            distance, box_id = self._after
            later = (distances > distance) | ((distances == distance) & (ids > box_id))
            order = order[later[order]]
        order = order[: self._limit]
        nearest = _flips(before, after, flips[order])
        listed = [
            (float(distances[at]), int(ids[at]), flip)
            for at, flip in zip(order.tolist(), nearest, strict=True)
        ]
        merged = sorted([*self.found, *listed], key=lambda flip: flip[:2])
        self.found = merged[: self._limit]


@dataclass(frozen=True)
class _Decided:
    """Boxes of a part of a dataset, and the decisions on all boxes of the part.

    They were decided by `config`. `rows` selects boxes of the part; None selects all.
    `version` is the one in which they were measured (`MeasureConfig.version`).
    """

    numbers: DatasetColumns
    evidence: Evidence
    config: FilterConfig
    decisions: Decisions
    rows: IntArray | None = None
    version: int = 1

    @cached_property
    def reasons(self) -> NDArray[np.uint8]:
        reasons = self.decisions.reason
        return reasons if self.rows is None else reasons[self.rows]

    def rows_of(self, places: IntArray) -> IntArray:
        """The rows in the part of boxes with these indexes."""
        return places if self.rows is None else self.rows[places]

    def margins(self, rows: IntArray) -> FloatArray:
        """How far the boxes of these rows are from the threshold that decides them.

        In percent of a box's pixels; NaN where none decides. Of those that other
        evidence than tags decides, from what that needs.
        """
        evidence = self.evidence.take(rows)
        decisions = rows_of(self.decisions, rows)
        own, needed = compared_by_channels(evidence, self.config, decisions)
        away = 100 * (own - needed) / np.maximum(evidence.box_pixels, 1)
        is_counted = ~np.isnan(own_percent(evidence, self.config.channels))
        by_channel = np.where(is_counted, away, np.nan)
        margins = np.where(decisions.channel > 0, by_channel, decisions.margin)
        distances: FloatArray = np.abs(margins)
        return distances

    def flip_sides(self, places: IntArray) -> list[wire.FlipSide]:
        """The decisions on boxes with these indexes."""
        rows = self.rows_of(places)
        matches = floats_or_none(self.evidence.shown_match(rows))
        thresholds = floats_or_none(self.decisions.threshold[rows])
        reasons = map(Reason, self.reasons[places].tolist())
        return [
            wire.FlipSide(
                verdict=reason.verdict.value,
                reason=reason.label,
                match_percent=match,
                threshold=threshold,
            )
            for reason, match, threshold in zip(
                reasons, matches, thresholds, strict=True
            )
        ]


def _causes(
    before: _Decided, after: _Decided, places: IntArray
) -> list[FlipCause | None]:
    """What besides the configuration has changed the verdicts of these boxes.

    None where nothing else is known to have.
    """
    then, now = before.rows_of(places), after.rows_of(places)
    if before.version >= after.version:
        return [None] * len(places)
    was_unknown = before.evidence.accept_mask[then] == 0
    is_known = was_unknown & (after.evidence.accept_mask[now] != 0)
    is_rounded: BoolArray = np.zeros(len(places), np.bool_)
    edges, new_edges = before.evidence.xyxy, after.evidence.xyxy
    if edges is not None and new_edges is not None:
        former, new = edges[then], new_edges[now]
        same = (former == new) | (np.isnan(former) & np.isnan(new))
        is_rounded = np.logical_not(same.all(axis=1))
    return [
        "class_known" if known else "edge_rounded" if rounded else None
        for known, rounded in zip(is_known.tolist(), is_rounded.tolist(), strict=True)
    ]


def _flips(before: _Decided, after: _Decided, places: IntArray) -> list[wire.Flip]:
    """The flips of boxes with these indexes, still without their rectangles."""
    rows = after.rows_of(places)
    names = after.evidence.class_names
    return [
        wire.Flip(
            box_id=box_id,
            frame_id=frame_id,
            class_name=names[class_index],
            xyxy=None,
            visible=None,
            match_percent=now.match_percent,
            before=then,
            after=now,
            cause=cause,
        )
        for box_id, frame_id, class_index, then, now, cause in zip(
            after.numbers.box_ids[rows].tolist(),
            after.numbers.frame_ids[rows].tolist(),
            after.evidence.class_index[rows].tolist(),
            before.flip_sides(places),
            after.flip_sides(places),
            _causes(before, after, places),
            strict=True,
        )
    ]


def _with_rectangles(
    session: Session, flips: Sequence[wire.Flip], measurement_id: int
) -> tuple[wire.Flip, ...]:
    """The flips with the rectangles of their boxes under a measurement."""
    rows = EvidenceRepository(session).numbers_of_frames(
        (flip.frame_id for flip in flips), measurement_id
    )
    rectangles: dict[int, XYXY] = {}
    for row in rows:
        corners = unpack_numbers([row.numbers], [row.box_count])["xyxy"].tolist()
        # NaN, which alone differs from itself: there is no rectangle in the image.
        rectangles |= {
            row.first_box_id + at: (x0, y0, x1, y1)
            for at, (x0, y0, x1, y1) in enumerate(corners)
            if x0 == x0
        }
    return tuple(
        flip.model_copy(update={"xyxy": rectangles.get(flip.box_id)}) for flip in flips
    )


def preview(
    context: ServiceContext, session: Session, dataset: Dataset, request: wire.PreviewIn
) -> wire.Preview:
    """The counts, histograms and flips of a configuration that is not applied."""
    active = active_config(session, dataset)
    config = load_config(request.config.root).after(active)
    plan = plan_for(DatasetReading.of(dataset), config)
    measurement = active_measurement(session, dataset)
    plan = in_version(session, dataset, plan, version_of(measurement))
    if needs_pixels(session, dataset, plan):
        unknown = wire.Preview.model_fields.keys() - {"config", "needs_pixels"}
        return wire.Preview(
            config=config.digest, needs_pixels=True, **dict.fromkeys(unknown)
        )
    is_recounted = not plan.is_covered_by(measurement.options)
    names = tuple(DatasetRepository(session).classes(dataset.id))
    table, nearest = FlipTable(names), _Nearest(request.limit)
    shares: IntArray = np.zeros((2, len(names), request.bins), np.int64)
    pixels: FloatArray = np.zeros((2, len(names)))
    kinds: Counter[EvidenceName] = Counter()
    truth = request.truth and KnownTruth.of(session, dataset, request.truth)
    scores = [Confusion(), Confusion()]
    visible: dict[int, bool] = {}
    cache = context.one(ColumnCache)
    for (numbers,) in cache.parts(session, dataset.id, measurement.id):
        evidence = numbers.evidence
        if is_recounted:
            evidence = _recounted(session, dataset, numbers, plan)
            needed = pixels_needed(evidence, config)
            shares += share_counts(evidence, config.channels, request.bins, needed)
        else:
            shares += numbers.share_counts(config.channels, request.bins, config)
        pixels += numbers.unknown_pixels()
        before = _Decided(numbers, numbers.evidence, active, numbers.decided(active))
        after = _Decided(numbers, evidence, config, decide(evidence, config))
        counts = np.bincount(after.decisions.channel, minlength=len(_KINDS))
        kinds.update(dict(zip(_KINDS, counts.tolist(), strict=True)))
        flips = table.add(evidence, before.reasons, after.reasons)
        nearest.add(before, after, flips)
        if truth:
            rows, is_visible = truth.rows(numbers)
            for side, decided in enumerate((before, after)):
                verdicts = VERDICT_OF_REASON[decided.reasons[rows]]
                judged = verdicts != UNMEASURED
                kept = verdicts[judged] == KEPT
                scores[side] += Confusion.of(kept, is_visible[judged])
            listed = np.array([box_id for _, box_id, _ in nearest.found], np.int64)
            places, is_known = places_in(numbers.box_ids[rows], listed)
            judged_ids = listed[is_known].tolist()
            visible.update(zip(judged_ids, is_visible[places].tolist(), strict=True))
    limits_of = config.limits_by_class(names)
    shown = [
        flip.model_copy(update={"visible": visible.get(box_id)})
        for _, box_id, flip in nearest.found
    ]
    before_and_after = [described(of_side) for of_side in scores]
    return wire.Preview(
        config=config.digest,
        needs_pixels=False,
        **outcome(names, table.after),
        histograms=histogram(names, shares[0], pixels, limits_of.threshold_small_box),
        own_histograms=histogram(
            names, shares[1], pixels, limits_of.min_visible_percent
        ),
        decided_by={name: boxes for name, boxes in kinds.items() if boxes},
        flips=wire.Flips(
            total=sum(table.flips_by_class().values()),
            **table.totals(),
            by_class=table.directions_by_class(),
            items=_with_rectangles(session, shown, measurement.id),
        ),
        scores=wire.TruthScores(
            boxes=scores[1].boxes, before=before_and_after[0], after=before_and_after[1]
        )
        if truth
        else None,
    )


def current_histogram(
    context: ServiceContext, session: Session, dataset: Dataset, bins: int
) -> Histogram:
    """Current matches per class, with the active configuration's thresholds.

    Of all measured boxes, also of those that other evidence decides.
    """
    measurement = active_measurement(session, dataset)
    names = tuple(DatasetRepository(session).classes(dataset.id))
    counts: IntArray = np.zeros((len(names), bins), np.int64)
    pixels: FloatArray = np.zeros((2, len(names)))
    cache = context.one(ColumnCache)
    config = active_config(session, dataset)
    for (numbers,) in cache.parts(session, dataset.id, measurement.id):
        counts += numbers.share_counts((), bins, config)[0]
        pixels += numbers.unknown_pixels()
    limits = config.limits_by_class(names).threshold_small_box
    return histogram(names, counts, pixels, limits)


def _recounted(
    session: Session, dataset: Dataset, numbers: DatasetColumns, plan: MeasureConfig
) -> Evidence:
    """The evidence of a part, with the columns that its frames' histograms give."""
    classes = DatasetRepository(session).classes(dataset.id)
    frame_ids = list(dict.fromkeys(numbers.frame_ids.tolist()))
    rows = EvidenceRepository(session).of_frames(
        frame_ids, filled(dataset.active_measurement_id)
    )
    parts = [recount(rows[key], classes, plan) for key in frame_ids]
    if not parts:
        return numbers.evidence
    return replace(
        numbers.evidence,
        accept_mask=np.concatenate([part.accept_mask for part in parts]),
        matched_pixels=np.concatenate([part.matched_pixels for part in parts]),
        match_percent=np.concatenate([part.match_percent for part in parts]),
        crowding=np.concatenate([part.crowding for part in parts]),
    )


def run_diff(
    context: ServiceContext,
    session: Session,
    runs: tuple[Run, Run],
    limit: int,
    cursor: str | None = None,
) -> wire.Diff:
    """Counts of boxes whose verdict differs, and a page of them after the cursor.

    Nearest to a threshold first.
    """
    configs = [
        config_of(ConfigRepository(session).with_id(run.config_id)) for run in runs
    ]
    measurements = [filled(run.measurement_id) for run in runs]
    names = tuple(DatasetRepository(session).classes(runs[1].dataset_id))
    table, causes = FlipTable(names), Counter[FlipCause]()
    versions = [
        version_of(EvidenceRepository(session).measurement_with_id(id_))
        for id_ in measurements
    ]
    # One more than the limit, to find out whether there is a next page.
    place = number_and_id_of_cursor(cursor) if cursor else None
    nearest = _Nearest(limit + 1, place)
    cache = context.one(ColumnCache)
    for numbers in cache.parts(session, runs[1].dataset_id, *measurements):
        rows = [np.arange(len(numbers[1]))] * 2
        if numbers[0] is not numbers[1]:
            # Frames that were added in between have numbers of one measurement only.
            _, *rows = np.intersect1d(
                numbers[0].box_ids,
                numbers[1].box_ids,
                assume_unique=True,
                return_indices=True,
            )
        before, after = (
            _Decided(part, part.evidence, config, decisions, of_part, version)
            for part, config, of_part, version in zip(
                numbers, configs, rows, versions, strict=True
            )
            for decisions in [decide(part.evidence, config)]
        )
        reasons = before.reasons, after.reasons
        flips = table.add(after.evidence, *reasons, after.rows)
        nearest.add(before, after, flips)
        causes.update(filter(None, _causes(before, after, flips)))
    listed, following = nearest.found[:limit], None
    if len(nearest.found) > limit:
        distance, box_id, _ = listed[-1]
        following = cursor_after(distance, box_id)
    by_class, sides = table.flips_by_class(), table.directions_by_class()
    return wire.Diff(
        run=runs[1].id,
        against=runs[0].id,
        compared=table.compared,
        total=sum(by_class.values()),
        **table.totals(),
        by_class=by_class,
        sides_by_class={name: sides[name] for name in sorted(sides)},
        by_cause=dict(sorted(causes.items())),
        items=_with_rectangles(session, [flip for *_, flip in listed], measurements[1]),
        next_cursor=following,
    )


def compared_runs(
    session: Session, run_id: int, against: int | None
) -> tuple[Run, Run]:
    """The run to compare with (default: the one active before), and the run.

    Raises Conflict: one of them is not done; BadRequest: there is no run to compare
    with, or it is of another dataset.
    """
    run = job_with_id(session, Run, run_id)
    other_id = against or run.previous_run_id
    if other_id is None:
        raise BadRequest(
            f"run {run_id} is the first of its dataset; pass ?against=ID",
            code="nothing_before",
        )
    other = job_with_id(session, Run, other_id)
    if other.dataset_id != run.dataset_id:
        raise BadRequest(
            f"run {other_id} is of another dataset than run {run_id}",
            code="other_dataset",
        )
    for each in (other, run):
        if each.state != "done":
            raise Conflict(
                f"run {each.id} is {each.state}; only runs that are done are compared",
                code="run_not_done",
            )
    return other, run
