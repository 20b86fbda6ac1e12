"""Filters of boxes: parsed from a request, as SQL, and applied to columns."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Final, NamedTuple

import numpy as np
from sqlalchemy import (
    ColumnElement,
    and_,
    case,
    exists,
    false,
    func,
    literal,
    or_,
    select,
    union_all,
)
from sqlalchemy.orm import Session

from app.catalog.datasets import DatasetRepository
from app.catalog.frames import current_in
from app.db.base import Repository
from app.db.bulk import chunks
from app.db.tables import Box, Dataset, Decision, Frame, Review
from app.errors import BadRequest
from app.measuring.active import active_config
from app.measuring.columns import DatasetColumns
from app.verdicts import (
    REVIEW_STATES,
    effective_verdict,
    in_bin,
    in_conflict,
    is_effective,
    is_in_conflict,
    is_not_in_conflict,
    reasons_of,
)
from filter_core.arrays import BoolArray, IntArray
from filter_core.config.filter import DecideConfig, FilterConfig
from filter_core.decisions.doubt import BIN_NAMED, Bin, bins_of
from filter_core.decisions.rules import deciding_thresholds
from filter_core.verdicts import Decisions, Reason, Verdict
from unghost.wire.boxes import BoxSelection

_WITHOUT_MATCH: Final = [int(reason) for reason in Reason if not reason.in_image]
"""Reasons of boxes without a pixel in the image; the database has 0 as their match."""


class TallyKey(NamedTuple):
    """The values that all boxes of a tally share; `review` is empty if unanswered."""

    class_id: int
    reason: int
    toss_up: bool
    bin: int
    review: str


class Side(NamedTuple):
    """Boxes of one class on one side of the threshold that decided them.

    `sign` is 1 if their matches lie above the threshold, -1 if below. Kept boxes whose
    match equals the threshold are on the upper side.
    """

    reason: Reason
    large: bool
    threshold: float
    sign: int


class ClassThresholds(NamedTuple):
    """The sides of a class's thresholds in the active configuration.

    A channel keeps boxes regardless of their match, and the table `decisions` has no
    column that says which boxes. Lists sort and filter them by how far their match is
    from `if_by_channel`, above or below. That is the class's `threshold_small_box`, or
    None if the configuration has no channels.
    """

    class_id: int
    sides: tuple[Side, ...]
    if_by_channel: float | None


def class_thresholds(
    config: DecideConfig, classes: Mapping[str, int]
) -> tuple[ClassThresholds, ...]:
    """The thresholds of the classes, given by their names with their ids."""
    limits = config.limits_by_class(list(classes))
    deciding = deciding_thresholds(limits)
    thresholds = []
    for row, class_id in enumerate(classes.values()):
        sides = [
            Side(
                reason,
                large,
                float(percent[row]),
                +1 if reason.verdict is Verdict.KEPT else -1,
            )
            for reason, large, percent in deciding
            if not math.isnan(percent[row])
        ]
        if_by_channel = None
        if config.channels:
            if_by_channel = float(limits.threshold_small_box[row])
            sides.append(Side(Reason.VISIBLE, False, if_by_channel, -1))
        thresholds.append(ClassThresholds(class_id, tuple(sides), if_by_channel))
    return tuple(thresholds)


@dataclass(frozen=True)
class BoxFilter:
    """A selection of boxes; None or empty means any.

    `not_by` leaves out boxes that this person has answered; it is not in tallies.
    `match_min` and the fields after it are not in tallies: ranges of numbers, then the
    key of a frame, and what its annotation says of it.
    """

    dataset_id: int
    reasons: tuple[int, ...] = ()
    class_ids: tuple[int, ...] | None = None
    review: str = ""
    effective: Verdict | None = None
    toss_up: bool | None = None
    bin: Bin | None = None
    conflict: bool | None = None
    match_min: float | None = None
    match_max: float | None = None
    margin_max: float | None = None
    distance_min: float | None = None
    distance_max: float | None = None
    frame: str | None = None
    map: str | None = None
    camera: str | None = None
    sequence: str | None = None
    weather: str | None = None
    thresholds: tuple[ClassThresholds, ...] = ()
    not_by: str = ""

    def conditions(self) -> list[ColumnElement[bool]]:
        """The selection as SQL."""
        return [Decision.dataset_id == self.dataset_id, *self._conditions()]

    def conditions_by_id(self) -> list[ColumnElement[bool]]:
        """As `conditions`, for boxes looked up by id; prevents use of other indexes."""
        return [Decision.dataset_id + 0 == self.dataset_id, *self._conditions()]

    def _conditions(self) -> list[ColumnElement[bool]]:
        conditions = [] if self.bin is None else [in_bin(self.bin)]
        if self.reasons:
            conditions.append(Decision.reason.in_(self.reasons))
        if self.class_ids is not None:
            conditions.append(Decision.class_id.in_(self.class_ids))
        if self.review:
            conditions.append(REVIEW_STATES[self.review].condition())
        if self.effective is not None:
            conditions.append(is_effective(self.effective))
        if self.toss_up is not None:
            conditions.append(Decision.toss_up.is_(self.toss_up))
        if self.conflict is not None:
            conditions.append(
                is_in_conflict() if self.conflict else is_not_in_conflict()
            )
        if self.not_by:
            own = (Review.box_id == Decision.box_id) & (Review.reviewer == self.not_by)
            conditions.append(~exists().where(own, Review.undoes.is_(None)))
        return conditions + self._ranges()

    def frame_conditions(self) -> list[ColumnElement[bool]]:
        """The frames that can have such boxes, as SQL: newest revisions alone."""
        places = {Frame.key: self.frame, Frame.map: self.map}
        places |= {Frame.camera: self.camera, Frame.sequence: self.sequence}
        places[Frame.weather] = self.weather
        return [
            *current_in(self.dataset_id),
            *(column == text for column, text in places.items() if text is not None),
        ]

    @property
    def has_places(self) -> bool:
        """Whether it selects boxes by their frames, which are not in tallies."""
        places = (self.frame, self.map, self.camera, self.sequence, self.weather)
        return any(text is not None for text in places)

    def selects(self, key: TallyKey) -> bool:
        """Whether it selects the boxes of this tally, its ranges aside."""
        effective = effective_verdict(key.reason, key.review)
        conflict = in_conflict(key.reason, key.review)
        return (
            (not self.reasons or key.reason in self.reasons)
            and (self.class_ids is None or key.class_id in self.class_ids)
            and (self.toss_up is None or key.toss_up is self.toss_up)
            and (self.bin is None or key.bin == self.bin)
            and (not self.review or key.review in REVIEW_STATES[self.review].answers)
            and (self.effective is None or effective == self.effective.value)
            and (self.conflict is None or conflict is self.conflict)
        )

    @property
    def is_beyond_tallies(self) -> bool:
        """Whether it has ranges of numbers or frames, which are not in tallies."""
        distances = (self.distance_min, self.distance_max)
        ranges = (self.match_min, self.match_max, self.margin_max, *distances)
        return self.has_places or any(limit is not None for limit in ranges)

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
        conditions: list[ColumnElement[bool]] = []
        if self.has_places:
            frames = select(Frame.id).where(*self.frame_conditions())
            conditions.append(Decision.frame_id.in_(frames))
        if self.has_match_range:
            conditions.append(Decision.reason.not_in(_WITHOUT_MATCH))
        if self.match_min is not None:
            conditions.append(Decision.match_percent >= self.match_min)
        if self.match_max is not None:
            conditions.append(Decision.match_percent <= self.match_max)
        if self.distance_min is not None:
            nearest = func.coalesce(Decision.distance, Decision.distance_from)
            conditions.append(nearest >= self.distance_min)
        if self.distance_max is not None:
            farthest = func.coalesce(Decision.distance, Decision.distance_to)
            conditions.append(farthest <= self.distance_max)
        if self.margin_max is not None:
            conditions.append(is_near(self.thresholds, self.margin_max))
        return conditions


def filters_of(selection: BoxSelection) -> dict[str, object]:
    """The filters that a request sets, by name, without its other parameters."""
    names = set(BoxSelection.model_fields)
    return selection.model_dump(include=names, exclude_none=True)


def to_filter(session: Session, dataset: Dataset, selection: BoxSelection) -> BoxFilter:
    """The filter; BadRequest names a value that is not known."""
    if selection.review and selection.review not in REVIEW_STATES:
        raise BadRequest(
            f"review: expected one of {', '.join(REVIEW_STATES)}, "
            f"found {selection.review!r}",
            code="unknown_review",
        )
    classes = DatasetRepository(session).classes(dataset.id)
    name = selection.class_name
    class_ids: tuple[int, ...] | None = None
    if name in classes:
        class_ids = (classes[name],)  # its name may have a comma
    elif name is not None:
        class_ids = tuple(classes[part] for part in name.split(",") if part in classes)
    config = active_config(session, dataset)
    names = {field.name for field in fields(BoxFilter)}
    same = selection.model_dump(include=names - {"review", "effective", "bin"})
    return BoxFilter(
        dataset_id=dataset.id,
        reasons=_reasons(selection),
        class_ids=class_ids,
        review=selection.review or "",
        effective=Verdict(selection.effective) if selection.effective else None,
        bin=None if selection.bin is None else BIN_NAMED[selection.bin],
        thresholds=class_thresholds(config, classes),
        **same,
    )


def is_near(
    thresholds: Iterable[ClassThresholds], margin: float
) -> ColumnElement[bool]:
    """Condition: a threshold decided, and the match is within `margin` of it.

    Its length hardly depends on the number of classes, since most have the same
    thresholds.
    """
    near = [
        and_(
            which,
            Decision.match_percent.between(threshold - margin, threshold + margin),
        )
        for which, threshold in thresholds_in_sql(thresholds)
    ]
    return or_(*near) if near else false()


def thresholds_in_sql(
    thresholds: Iterable[ClassThresholds],
) -> list[tuple[ColumnElement[bool], ColumnElement[float]]]:
    """For each reason and size: a condition, and the threshold that decided such boxes.

    The threshold is an expression of a box's class: a number if all classes have the
    same.
    """
    numbers: dict[tuple[Reason, bool], dict[int, float]] = {}
    for of_class in thresholds:
        for side in of_class.sides:
            by_class = numbers.setdefault((side.reason, side.large), {})
            by_class[of_class.class_id] = side.threshold
    pairs = []
    for (reason, large), by_class in numbers.items():
        which = and_(Decision.reason == int(reason), Decision.large.is_(large))
        ((usual, _),) = Counter(by_class.values()).most_common(1)
        others = {key: number for key, number in by_class.items() if number != usual}
        threshold: ColumnElement[float] = literal(usual)
        if others:
            threshold = case(others, value=Decision.class_id, else_=usual)
        pairs.append((which, threshold))
    return pairs


class BoxProbes(Repository):
    """Queries for the boxes that a filter selects, and for ids of boxes."""

    def span(self, dataset_id: int, class_ids: Iterable[int]) -> tuple[int, int] | None:
        """The lowest and the highest id of a dataset's boxes; None without boxes."""
        # Two lookups in the index for each class. SQLite allows 500 in one statement.
        box_ids: list[int] = []
        for together in chunks(sorted(class_ids), most=100):
            ends = [
                select(end(Decision.box_id)).where(
                    Decision.dataset_id == dataset_id, Decision.class_id == class_id
                )
                for class_id in together
                for end in (func.min, func.max)
            ]
            rows: Iterable[int | None] = self._session.scalars(union_all(*ends))
            box_ids += [box_id for box_id in rows if box_id is not None]
        return (min(box_ids), max(box_ids)) if box_ids else None

    def newest_id(self) -> int:
        """The id of the newest box of all datasets; 0 if there is none."""
        return self._session.scalar(select(func.max(Box.id))) or 0

    def count(self, box_filter: BoxFilter) -> int:
        """How many boxes the filter selects, counted by the database."""
        rows = select(func.count()).select_from(Decision)
        return self._session.scalar(rows.where(*box_filter.conditions())) or 0

    def selected(self, box_filter: BoxFilter, box_ids: Sequence[int]) -> list[int]:
        """Which of the given boxes the filter selects, in the order given."""
        conditions = box_filter.conditions_by_id()
        selected_ids: set[int] = set()
        for chunk in chunks(box_ids):
            is_given = Decision.box_id.in_(chunk)
            rows = select(Decision.box_id).where(is_given, *conditions)
            selected_ids.update(self._session.scalars(rows))
        return [box_id for box_id in box_ids if box_id in selected_ids]

    def every(self, box_filter: BoxFilter) -> IntArray:
        """All boxes of the filter, in no order."""
        rows = select(Decision.box_id).where(*box_filter.conditions())
        return np.fromiter(self._session.scalars(rows), np.int64)


def _reasons(selection: BoxSelection) -> tuple[int, ...]:
    chosen = set(map(int, Reason))
    if selection.verdict:
        chosen &= set(reasons_of(Verdict(selection.verdict)))
    if selection.reason:
        try:
            chosen &= {
                int(reason)
                for name in selection.reason.split(",")
                for reason in Reason.with_label(name)
            }
        except ValueError as error:
            raise BadRequest(str(error), code="unknown_reason") from error
    if len(chosen) == len(Reason):
        return ()
    # A verdict and a reason that exclude each other select nothing, not everything.
    return tuple(sorted(chosen)) or (0,)


def selected(
    numbers: DatasetColumns, config: FilterConfig, box_filter: BoxFilter
) -> BoolArray:
    """Which boxes the filter selects, as in SQL; filters by answers are not applied.

    NaN is in no range, and neither is the match of a box that is not in the image.
    """
    decisions = numbers.decided(config)
    chosen = np.ones(len(numbers), np.bool_)
    if box_filter.reasons:
        chosen &= np.isin(decisions.reason, box_filter.reasons)
    if box_filter.class_ids is not None:
        chosen &= np.isin(numbers.class_ids, box_filter.class_ids)
    if box_filter.toss_up is not None:
        chosen &= decisions.toss_up == box_filter.toss_up
    if box_filter.bin is not None:
        chosen &= bins_of(numbers.doubt(config)) == box_filter.bin
    return chosen & _in_ranges(numbers, decisions, box_filter)


def _in_ranges(
    numbers: DatasetColumns, decisions: Decisions, box_filter: BoxFilter
) -> BoolArray:
    """Which boxes are in the filter's ranges of numbers."""
    match = numbers.evidence.match_percent
    nearest, farthest = numbers.evidence.distance_bounds()
    chosen = np.ones(len(numbers), np.bool_)
    if box_filter.margin_max is not None:
        # Of boxes that channels kept, the threshold of small boxes. None becomes NaN.
        threshold = decisions.threshold.copy()
        by_channel = np.isnan(threshold) & (decisions.reason == Reason.VISIBLE)
        by_class = {each.class_id: each.if_by_channel for each in box_filter.thresholds}
        class_ids = numbers.class_ids[by_channel].tolist()
        threshold[by_channel] = [by_class.get(class_id) for class_id in class_ids]
        chosen &= match >= threshold - box_filter.margin_max
        chosen &= match <= threshold + box_filter.margin_max
    has_no_match = np.isin(decisions.reason, _WITHOUT_MATCH)
    for column, low, high in (
        (
            np.where(has_no_match, np.nan, match),
            box_filter.match_min,
            box_filter.match_max,
        ),
        (nearest, box_filter.distance_min, None),
        (farthest, None, box_filter.distance_max),
    ):
        if low is not None:
            chosen &= column >= low
        if high is not None:
            chosen &= column <= high
    return chosen
