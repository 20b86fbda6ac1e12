"""Filters of boxes: parsed from a request, as SQL, and applied to columns."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from sqlalchemy import ColumnElement, and_, false, func, or_, select, union_all
from sqlalchemy.orm import Session

from app.db.bulk import chunks
from app.db.tables import Box, Dataset, Decision
from app.errors import BadRequest
from app.measuring.active import active_version, config_of
from app.measuring.columns import DatasetColumns
from app.measuring.queries import DatasetRepository
from app.verdicts import (
    REVIEW_STATES,
    is_effective,
    is_in_conflict,
    is_not_in_conflict,
    reasons_of,
)
from filter_core.types import (
    BoolArray,
    Decisions,
    FloatArray,
    IntArray,
    Reason,
    Verdict,
)
from unghost.wire.boxes import BoxSelection

THRESHOLD_REASONS = (
    Reason.VISIBLE,
    Reason.BELOW_THRESHOLD,
    Reason.LARGE_BELOW_THRESHOLD,
)
"""Reasons of decisions that can have a margin.

VISIBLE has none where a channel kept the box; such boxes are sorted and filtered by
another distance, see `ClassThresholds`.
"""


@dataclass(frozen=True)
class Selection:
    """The filters of a request, by their names on the wire; None: not set."""

    verdict: str | None = None
    effective: str | None = None
    reason: str | None = None
    class_name: str | None = None
    review: str | None = None
    toss_up: bool | None = None
    conflict: bool | None = None
    match_min: float | None = None
    match_max: float | None = None
    margin_max: float | None = None
    distance_min: float | None = None
    distance_max: float | None = None

    def selects(self) -> bool:
        """Whether any filter is set."""
        return self != Selection()


_WITHOUT_MATCH: Final = [int(reason) for reason in Reason if not reason.in_image]
"""Reasons of boxes without a pixel in the image; the database has 0 as their match."""
_NAMES = {spec.name for spec in fields(Selection)}


@dataclass(frozen=True)
class ClassThresholds:
    """The thresholds of a class in the active configuration, in percent.

    They are those of `filter_core`'s `LimitsByClass`, together with the id of the
    class, for use in SQL conditions.

    A large box has to reach `large` and, under the profile `carlasimu`, `small` as
    well: `kept_large` is the higher one of those that apply.

    If `by_channels` is true, channels judge boxes regardless of their match, and the
    table `decisions` has no column that says which boxes. Lists sort and filter boxes
    that a channel kept by how far their match is from `small`, above or below.
    """

    class_id: int
    small: float
    large: float
    kept_large: float
    by_channels: bool = False

    def sides(self) -> Iterator[Side]:
        """The sides of the thresholds on which there can be boxes."""
        yield Side(Reason.VISIBLE, False, self.small, 1)
        yield Side(Reason.BELOW_THRESHOLD, False, self.small, -1)
        yield Side(Reason.VISIBLE, True, self.kept_large, 1)
        yield Side(Reason.LARGE_BELOW_THRESHOLD, True, self.large, -1)
        if (
            self.kept_large > self.large
        ):  # under carlasimu: `small` has to be reached too
            yield Side(Reason.BELOW_THRESHOLD, True, self.small, -1)
        if self.by_channels:  # boxes that a channel kept although their match is lower
            yield Side(Reason.VISIBLE, False, self.small, -1)


@dataclass(frozen=True)
class BoxFilter:
    """A selection of boxes; None or empty means any.

    `match_min` and the fields after it are ranges of numbers, which are not in tallies.
    """

    dataset_id: int
    reasons: tuple[int, ...] = ()
    class_ids: tuple[int, ...] | None = None
    review: str = ""
    effective: Verdict | None = None
    toss_up: bool | None = None
    conflict: bool | None = None
    match_min: float | None = None
    match_max: float | None = None
    margin_max: float | None = None
    distance_min: float | None = None
    distance_max: float | None = None
    thresholds: tuple[ClassThresholds, ...] = ()

    def conditions(self) -> list[ColumnElement[bool]]:
        """The selection as SQL."""
        return [Decision.dataset_id == self.dataset_id, *self._conditions()]

    def conditions_by_id(self) -> list[ColumnElement[bool]]:
        """As `conditions`, for boxes looked up by id; prevents use of other indexes."""
        return [Decision.dataset_id + 0 == self.dataset_id, *self._conditions()]

    def _conditions(self) -> list[ColumnElement[bool]]:
        found: list[ColumnElement[bool]] = []
        if self.reasons:
            found.append(Decision.reason.in_(self.reasons))
        if self.class_ids is not None:
            found.append(Decision.class_id.in_(self.class_ids))
        if self.review:
            found.append(REVIEW_STATES[self.review].condition())
        if self.effective is not None:
            found.append(is_effective(self.effective))
        if self.toss_up is not None:
            found.append(Decision.toss_up.is_(self.toss_up))
        if self.conflict is not None:
            found.append(is_in_conflict() if self.conflict else is_not_in_conflict())
        return found + self._ranges()

    def unanswered(self) -> list[ColumnElement[bool]]:
        """A condition to add where the index of unanswered boxes should be read.

        The database prefers that index even where another one leads to far fewer boxes.
        """
        return [Decision.review.is_(None)] if self.review == "none" else []

    @property
    def has_ranges(self) -> bool:
        """Whether it has ranges of numbers, which are not in tallies."""
        ranges = (
            *(self.match_min, self.match_max, self.margin_max),
            *(self.distance_min, self.distance_max),
        )
        return any(limit is not None for limit in ranges)

    @property
    def is_found_by_match(self) -> bool:
        """Whether the index on matches finds the boxes, and so not in order of id."""
        return self.has_match_range and not self.only_answered

    @property
    def has_match_range(self) -> bool:
        """Whether it has a range of matches, in which boxes without a match are not."""
        return self.match_min is not None or self.match_max is not None

    @property
    def only_answered(self) -> bool:
        """Whether all of them were answered: few boxes, with an index of their own."""
        answers = REVIEW_STATES[self.review].answers if self.review else ("",)
        return "" not in answers or self.conflict is True

    def _ranges(self) -> list[ColumnElement[bool]]:
        found: list[ColumnElement[bool]] = []
        if self.has_match_range:
            found.append(Decision.reason.not_in(_WITHOUT_MATCH))
        if self.match_min is not None:
            found.append(Decision.match_percent >= self.match_min)
        if self.match_max is not None:
            found.append(Decision.match_percent <= self.match_max)
        if self.distance_min is not None:
            found.append(Decision.distance >= self.distance_min)
        if self.distance_max is not None:
            found.append(Decision.distance <= self.distance_max)
        if self.margin_max is not None:
            found.append(is_near(self.thresholds, self.margin_max))
        return found


class Side(NamedTuple):
    """Boxes of one class on one side of their threshold.

    `sign` is 1 if their matches lie above the threshold, -1 if below. Kept boxes whose
    match equals the threshold are on the upper side.
    """

    reason: Reason
    large: bool
    threshold: float
    sign: int


def selection_of(query: BoxSelection) -> Selection:
    """The filters among the query parameters of a list."""
    return Selection(**query.model_dump(include=_NAMES))


def to_filter(session: Session, dataset: Dataset, wanted: Selection) -> BoxFilter:
    """The filter; BadRequest names a value that is not known."""
    classes = DatasetRepository(session).classes(dataset.id)
    config = config_of(active_version(session, dataset))
    limits = config.limits_by_class(list(classes))
    thresholds = tuple(
        ClassThresholds(
            class_id=class_id,
            small=float(limits.threshold_small_box[row]),
            large=float(limits.threshold_big_box[row]),
            kept_large=float(limits.threshold_kept_large_box[row]),
            by_channels=bool(config.channels),
        )
        for row, class_id in enumerate(classes.values())
    )
    return BoxFilter(
        dataset_id=dataset.id,
        reasons=_reasons(wanted),
        class_ids=_class_ids(wanted.class_name, classes),
        review=_review(wanted.review),
        effective=Verdict(wanted.effective) if wanted.effective else None,
        toss_up=wanted.toss_up,
        conflict=wanted.conflict,
        match_min=wanted.match_min,
        match_max=wanted.match_max,
        margin_max=wanted.margin_max,
        distance_min=wanted.distance_min,
        distance_max=wanted.distance_max,
        thresholds=thresholds,
    )


def is_near(
    thresholds: Sequence[ClassThresholds], margin: float
) -> ColumnElement[bool]:
    """Condition: a threshold decided, and the match is within `margin` of it."""
    return _is_near(tuple(thresholds), margin)


@lru_cache(maxsize=256)
def _is_near(
    thresholds: tuple[ClassThresholds, ...], margin: float
) -> ColumnElement[bool]:
    # Cached: building it takes longer than reading a page. By class first, so that a
    # row is compared with the sides of its own class alone.
    near = [
        and_(
            Decision.class_id == wanted.class_id,
            or_(*(_is_near_side(side, margin) for side in wanted.sides())),
        )
        for wanted in thresholds
    ]
    with_margin = Decision.reason.in_([int(reason) for reason in THRESHOLD_REASONS])
    return and_(with_margin, or_(*near)) if near else false()


def _is_near_side(side: Side, margin: float) -> ColumnElement[bool]:
    return and_(
        Decision.reason == int(side.reason),
        Decision.large.is_(side.large),
        Decision.match_percent.between(
            side.threshold - margin, side.threshold + margin
        ),
    )


class BoxProbes:
    """Queries for the boxes that a filter selects, and for ids of boxes."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def span(self, dataset_id: int, class_ids: Iterable[int]) -> tuple[int, int] | None:
        """The lowest and the highest id of a dataset's boxes; None without boxes."""
        # Two lookups in the index for each class.
        ends = [
            select(end(Decision.box_id)).where(
                Decision.dataset_id == dataset_id, Decision.class_id == class_id
            )
            for class_id in class_ids
            for end in (func.min, func.max)
        ]
        if not ends:
            return None
        rows: Iterable[tuple[int | None]] = self._session.execute(union_all(*ends))
        found = [box_id for (box_id,) in rows if box_id is not None]
        return (min(found), max(found)) if found else None

    def newest_id(self) -> int:
        """The id of the newest box of all datasets; 0 if there is none."""
        return self._session.scalar(select(func.max(Box.id))) or 0

    def count(self, wanted: BoxFilter) -> int:
        """How many boxes the filter selects, counted by the database."""
        rows = select(func.count()).select_from(Decision)
        return self._session.scalar(rows.where(*wanted.conditions())) or 0

    def selected(self, wanted: BoxFilter, box_ids: Sequence[int]) -> list[int]:
        """Those of these boxes that the filter selects, in their order."""
        if not box_ids:
            return []
        conditions = wanted.conditions_by_id()
        found: set[int] = set()
        for chunk in chunks(box_ids):
            rows = select(Decision.box_id).where(
                Decision.box_id.in_(chunk), *conditions
            )
            found.update(self._session.scalars(rows))
        return [box_id for box_id in box_ids if box_id in found]

    def every(self, wanted: BoxFilter) -> IntArray:
        """All boxes of the filter, in no order."""
        # Toss-ups are far fewer than boxes without an answer.
        unanswered = [] if wanted.toss_up else wanted.unanswered()
        rows = select(Decision.box_id).where(*wanted.conditions(), *unanswered)
        return np.fromiter(self._session.scalars(rows), np.int64)


def _reasons(wanted: Selection) -> tuple[int, ...]:
    chosen = set(map(int, Reason))
    if wanted.verdict:
        chosen &= set(reasons_of(Verdict(wanted.verdict)))
    if wanted.reason:
        try:
            chosen &= {
                int(Reason.from_label(name)) for name in wanted.reason.split(",")
            }
        except ValueError as error:
            raise BadRequest(str(error), code="unknown_reason") from error
    if len(chosen) == len(Reason):
        return ()
    # A verdict and a reason that exclude each other select nothing, not everything.
    return tuple(sorted(chosen)) or (0,)


def _class_ids(name: str | None, classes: dict[str, int]) -> tuple[int, ...] | None:
    if name is None:
        return None
    if name in classes:
        return (classes[name],)  # its name may have a comma
    return tuple(classes[one] for one in name.split(",") if one in classes)


def _review(wanted: str | None) -> str:
    if wanted and wanted not in REVIEW_STATES:
        raise BadRequest(
            f"review: expected one of {', '.join(REVIEW_STATES)}, found {wanted!r}",
            code="unknown_review",
        )
    return wanted or ""


def selected(
    numbers: DatasetColumns, decisions: Decisions, wanted: BoxFilter
) -> BoolArray:
    """Which boxes the filter selects, as in SQL; filters by answers are not applied.

    NaN is in no range, and neither is the match of a box that is not in the image.
    """
    evidence = numbers.evidence
    match, distance = evidence.match_percent, evidence.distance
    chosen = np.ones(len(numbers), np.bool_)
    if wanted.reasons:
        chosen &= np.isin(decisions.reason, wanted.reasons)
    if wanted.class_ids is not None:
        chosen &= np.isin(numbers.class_ids, wanted.class_ids)
    if wanted.toss_up is not None:
        chosen &= decisions.toss_up == wanted.toss_up
    if wanted.margin_max is not None:
        threshold = _thresholds(numbers, decisions, wanted.thresholds)
        chosen &= match >= threshold - wanted.margin_max
        chosen &= match <= threshold + wanted.margin_max
    has_no_match = np.isin(decisions.reason, _WITHOUT_MATCH)
    for column, low, high in (
        (np.where(has_no_match, np.nan, match), wanted.match_min, wanted.match_max),
        (distance, wanted.distance_min, wanted.distance_max),
    ):
        if low is not None:
            chosen &= column >= low
        if high is not None:
            chosen &= column <= high
    return chosen


def _thresholds(
    numbers: DatasetColumns,
    decisions: Decisions,
    thresholds: Sequence[ClassThresholds],
) -> FloatArray:
    """The threshold of each box; of those that channels kept, that of small boxes."""
    small_of = {one.class_id: one.small for one in thresholds if one.by_channels}
    by_channel = np.isnan(decisions.threshold) & (decisions.reason == Reason.VISIBLE)
    if not small_of or not by_channel.any():
        return decisions.threshold
    found: FloatArray = decisions.threshold.copy()
    class_ids = numbers.class_ids[by_channel].tolist()
    found[by_channel] = [small_of.get(class_id, np.nan) for class_id in class_ids]
    return found
