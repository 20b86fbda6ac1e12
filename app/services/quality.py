"""How well the filter and the truth agree: on verdicts, on thresholds; and people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.db.tables import Dataset
from app.repositories.answers import AnsweredBox, AnswerRepository
from app.repositories.datasets import DatasetRepository
from app.repositories.tallies import TallyRepository
from app.services.configs import active_version, config_of
from app.services.numbers import NumbersCache
from app.services.reviewers import Panel
from app.services.run_requests import active_measurement
from app.services.statistics import count
from filter_core.config.filter import FilterConfig
from filter_core.evaluation.comparison import truth_from_instances
from filter_core.evaluation.scores import BANDS, band_index
from filter_core.evaluation.thresholds import (
    Goal,
    Judged,
    is_by_threshold,
    suggest_per_class,
)
from filter_core.types import VERDICT_OF_REASON, Verdict
from unghost.wire.quality import Band, Confusion, Quality, Suggestion
from unghost.wire.words import Truth

KEPT, UNMEASURED = (list(Verdict).index(v) for v in (Verdict.KEPT, Verdict.UNMEASURED))


def quality(
    context: ServiceContext,
    session: Session,
    dataset: Dataset,
    asked: tuple[Truth, Goal],
) -> Quality:
    """Everything that the truth says about the filter, and people about each other."""
    truth, goal = asked
    config = config_of(active_version(session, dataset))
    if truth == "people":
        boxes = AnswerRepository(session).decided(dataset.id)
        total, judged = len(boxes), _by_people(boxes)
        classes = DatasetRepository(session).classes(dataset.id)
    else:
        total, judged = _by_instances(context, session, dataset, config)
        names = DatasetRepository(session).classes(dataset.id)
        classes = {name: index for index, name in enumerate(names)}
    counts = count(TallyRepository(session).of_dataset(dataset.id))
    panel = Panel.of(session, dataset.id)
    return Quality(
        truth=truth,
        reviewed=counts.reviewed,
        unsure=counts.unsure,
        unmeasured=total - len(judged),
        confusion=Confusion(**_counted(judged)),
        by_class=_by_class(judged, classes),
        by_distance=_by_distance(judged),
        reviewers=panel.reviewers(),
        agreement=panel.agreement(),
        suggested=tuple(
            Suggestion.model_validate(one.as_dict())
            for one in suggest_per_class(judged, classes, config, goal)
        ),
    )


def _by_people(boxes: Sequence[AnsweredBox]) -> Judged:
    """Without boxes that the filter had nothing to measure with."""
    columns = list(zip(*boxes, strict=True)) or [()] * len(AnsweredBox._fields)
    _, class_id, reason, large, match, distance, review = columns
    reasons = np.array(reason, np.int64)
    verdict = VERDICT_OF_REASON[reasons]
    return Judged(
        np.array(class_id, np.int64),
        np.array(distance, np.float64),
        np.array(match, np.float64),
        is_by_threshold(reasons, np.array(large, np.bool_)),
        verdict == KEPT,
        np.array(review, object) == "keep",
    ).where(verdict != UNMEASURED)


def _by_instances(
    context: ServiceContext, session: Session, dataset: Dataset, config: FilterConfig
) -> tuple[int, Judged]:
    """How many boxes have a truth, and those that can be judged."""
    measurement = active_measurement(session, dataset)
    total, judged = 0, []
    cache = context.one(NumbersCache)
    for (numbers,) in cache.parts(session, dataset.id, measurement.id):
        rows, visible = truth_from_instances(numbers.evidence)
        total += len(rows)
        judged.append(Judged.of(numbers.evidence.take(rows), config, visible))
    return total, Judged.joined(judged)


def _counted(judged: Judged) -> dict[str, Any]:
    """Counts under the names that they have where the truth is an answer."""
    scores = judged.confusion.as_dict()
    return {
        "kept_keep": scores["kept_visible"],
        "kept_reject": scores["kept_hidden"],
        "rejected_keep": scores["rejected_visible"],
        "rejected_reject": scores["rejected_hidden"],
        **{name: scores[name] for name in ("precision", "recall", "f1")},
    }


def _by_class(judged: Judged, classes: Mapping[str, int]) -> dict[str, Confusion]:
    rows = {name: judged.class_key == key for name, key in classes.items()}
    return {
        name: Confusion(**_counted(judged.where(mine)))
        for name, mine in rows.items()
        if mine.any()
    }


def _by_distance(judged: Judged) -> tuple[Band, ...]:
    index = band_index(judged.distance)
    return tuple(
        Band(band=name, **_counted(judged.where(index == place)))
        for place, name in enumerate(BANDS)
    )
