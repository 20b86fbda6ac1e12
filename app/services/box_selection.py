"""From what a person filters by to what the database looks for."""

from __future__ import annotations

from dataclasses import dataclass

from sqlalchemy.orm import Session

from app.db.tables import Dataset
from app.errors import BadRequest
from app.repositories.box_filter import BoxFilter, ClassThresholds
from app.repositories.datasets import DatasetRepository
from app.services.configs import active_version, config_of
from app.verdicts import REVIEW_STATES, reasons_of
from filter_core.types import Reason, Verdict


@dataclass(frozen=True)
class Selection:
    """Filters by name; None where there is none."""

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
        """Whether anything is filtered by."""
        return self != Selection()


def to_filter(session: Session, dataset: Dataset, wanted: Selection) -> BoxFilter:
    """The filter; BadRequest names a value that is not known."""
    classes = DatasetRepository(session).classes(dataset.id)
    config = config_of(active_version(session, dataset))
    limits = config.thresholds_for(list(classes))
    thresholds = tuple(
        ClassThresholds(*one)
        for one in zip(
            classes.values(),
            limits.threshold_small_box.tolist(),
            limits.threshold_big_box.tolist(),
            limits.threshold_kept_large_box.tolist(),
            strict=True,
        )
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
    return tuple(classes[one] for one in name.split(",") if one in classes)


def _review(wanted: str | None) -> str:
    if wanted and wanted not in REVIEW_STATES:
        raise BadRequest(
            f"review: expected one of {', '.join(REVIEW_STATES)}, found {wanted!r}",
            code="unknown_review",
        )
    return wanted or ""
