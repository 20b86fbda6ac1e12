"""Compares the filter, people and kinds of evidence with the truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from sqlalchemy.orm import Session

from app.boxes.counts import count
from app.boxes.current import TallyRepository
from app.context import ServiceContext
from app.db.tables import Dataset, Run
from app.measuring.active import active_version, config_of
from app.measuring.columns import ColumnCache, DatasetColumns
from app.measuring.plan import active_measurement
from app.measuring.queries import DatasetRepository
from app.quality.queries import AnsweredBox, AnswerRepository
from app.runs.service import RunRequest, coming_settings, request_run
from app.verdicts import verdict_of
from filter_core.config.filter import FilterConfig
from filter_core.evaluation import comparison
from filter_core.evaluation.agreement import agreement
from filter_core.evaluation.comparison import truth_from_instances
from filter_core.evaluation.scores import BANDS, Measured, band_index
from filter_core.evaluation.thresholds import (
    Goal,
    Judged,
    is_by_threshold,
    suggest_per_class,
)
from filter_core.evidence_kinds import CHANNELS, SEMANTIC
from filter_core.types import (
    KEPT,
    UNMEASURED,
    VERDICT_OF_REASON,
    BoolArray,
    IntArray,
    Verdict,
)
from unghost.wire.quality import (
    Agreement,
    Band,
    Confusion,
    Evaluation,
    Pair,
    Quality,
    Reviewer,
    Suggestion,
)
from unghost.wire.words import Truth


def request_evaluation(
    context: ServiceContext, session: Session, dataset: Dataset, author: str
) -> Run:
    """Queue a run that measures every channel that the frames' files allow.

    Verdicts do not change: the configuration is the active one. From then on new frames
    are measured by every channel, too.
    """
    _, config = coming_settings(session, dataset)
    wanted = RunRequest(config, author, activate=True, channels=CHANNELS)
    return request_run(context, session, dataset, wanted)


def evaluation(
    context: ServiceContext, session: Session, dataset: Dataset, truth: Truth
) -> Evaluation:
    """How often each measured channel is right, from stored numbers."""
    measurement = active_measurement(session, dataset)
    stored = measurement.options.get("channels") or {}
    channels = tuple(name for name in CHANNELS if name in stored.get("names", ()))
    compared = comparison.Evaluation(
        config_of(active_version(session, dataset)), (SEMANTIC, *channels)
    )
    truth_of = (
        _truth_by_people(session, dataset) if truth == "people" else _truth_by_instances
    )
    cache = context.one(ColumnCache)
    for (numbers,) in cache.parts(session, dataset.id, measurement.id):
        _compare(compared, numbers, *truth_of(numbers))
    missing = [name for name in CHANNELS if name not in channels]
    return Evaluation.model_validate(
        {"truth": truth, "not_measured": missing, **compared.as_dict()}
    )


def _compare(
    compared: comparison.Evaluation,
    numbers: DatasetColumns,
    rows: IntArray,
    visible: BoolArray,
) -> None:
    frames = numbers.frame_ids[rows]

    def name_of(row: int) -> dict[str, int]:
        return {
            "box_id": int(numbers.box_ids[rows[row]]),
            "frame_id": int(frames[row]),
        }

    evidence = numbers.evidence.take(rows)
    compared.add(evidence, visible, len(np.unique(frames)), name_of)


def _truth_by_instances(numbers: DatasetColumns) -> tuple[IntArray, BoolArray]:
    return truth_from_instances(numbers.evidence)


def _truth_by_people(
    session: Session, dataset: Dataset
) -> Callable[[DatasetColumns], tuple[IntArray, BoolArray]]:
    """A function that finds the boxes which people decided.

    It takes the numbers of a dataset, and returns the rows of these boxes in them, and
    for each row whether the latest answer is keep.
    """
    answered = AnswerRepository(session).decided(dataset.id)
    box_ids = np.array([box.box_id for box in answered], np.int64)
    keep = np.array([_is_kept(box.review) for box in answered], np.bool_)

    def truth_of(numbers: DatasetColumns) -> tuple[IntArray, BoolArray]:
        rows = np.searchsorted(numbers.box_ids, box_ids)
        # Other boxes are in another part, or were stored after the numbers were read.
        known = rows < len(numbers)
        known[known] = numbers.box_ids[rows[known]] == box_ids[known]
        return rows[known].astype(np.int64), keep[known]

    return truth_of


def quality(
    context: ServiceContext,
    session: Session,
    dataset: Dataset,
    asked: tuple[Truth, Goal],
) -> Quality:
    """The filter compared with the truth, and people compared with each other."""
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
    """The boxes that people decided, except those that the filter did not measure."""
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
        np.array([_is_kept(answer) for answer in review], np.bool_),
    ).where(verdict != UNMEASURED)


def _by_instances(
    context: ServiceContext, session: Session, dataset: Dataset, config: FilterConfig
) -> tuple[int, Judged]:
    """How many boxes have a truth, and the boxes that can be judged."""
    measurement = active_measurement(session, dataset)
    total, judged = 0, []
    cache = context.one(ColumnCache)
    for (numbers,) in cache.parts(session, dataset.id, measurement.id):
        rows, visible = truth_from_instances(numbers.evidence)
        total += len(rows)
        judged.append(Judged.of(numbers.evidence.take(rows), config, visible))
    return total, Judged.joined(judged)


def _counted(judged: Judged) -> dict[str, object]:
    """Counts, with the names of the wire: those for answers as the truth."""
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


@dataclass(frozen=True)
class Panel:
    """The latest answer of each reviewer on each box, except cleared ones."""

    latest: dict[tuple[int, str], str]

    @classmethod
    def of(cls, session: Session, dataset_id: int) -> Panel:
        """The panel of a dataset.

        Answers that were undone do not count, and neither do the answers that the undo
        repeated, since no person gave them. Of an undone bulk answer none counts, not
        even on boxes that the undo has left as they were.
        """
        repository = AnswerRepository(session)
        ignored = repository.undone_batches(dataset_id)
        undone: set[tuple[int, int]] = set()
        latest: dict[tuple[int, str], str] = {}
        for answer in repository.answers(dataset_id):
            if (answer.box_id, answer.revision) in undone:
                continue
            if answer.undoes is not None:
                undone.add((answer.box_id, answer.undoes))
            elif answer.batch_id not in ignored:
                latest.setdefault((answer.box_id, answer.reviewer), answer.verdict)
        given = {key: verdict for key, verdict in latest.items() if verdict != "clear"}
        return cls(given)

    def reviewers(self) -> tuple[Reviewer, ...]:
        """How many boxes each reviewer answered, and how; the most active first."""
        counts = Counter((who, verdict) for (_, who), verdict in self.latest.items())
        totals = Counter(who for _, who in self.latest)
        return tuple(
            Reviewer(
                name=who,
                answers=total,
                keep=counts[who, "keep"],
                reject=counts[who, "reject"],
                unsure=counts[who, "unsure"],
            )
            for who, total in sorted(totals.items(), key=lambda one: (-one[1], one[0]))
        )

    def agreement(self) -> Agreement:
        """How far reviewers agree on boxes that several of them decided."""
        decided = [
            (box, who, _is_kept(verdict))
            for (box, who), verdict in self.latest.items()
            if verdict_of(verdict) is not None
        ]
        names = sorted({who for _, who, _ in decided})
        place = {name: index for index, name in enumerate(names)}
        found = agreement(
            np.array([box for box, _, _ in decided], np.int64),
            np.array([place[who] for _, who, _ in decided], np.int64),
            np.array([keep for _, _, keep in decided], np.bool_),
        )
        kappa = found.kappa
        return Agreement(
            boxes=found.boxes,
            agreed=found.agreed,
            percent=100 * found.agreed / found.boxes if found.boxes else None,
            kappa=_value(kappa),
            interval=(kappa.low, kappa.high) if kappa else None,
            pairs=tuple(
                Pair(
                    a=names[pair.a],
                    b=names[pair.b],
                    boxes=pair.boxes,
                    agreed=pair.agreed,
                    kappa=_value(pair.kappa),
                )
                for pair in found.pairs
            ),
        )


def _is_kept(answer: str | None) -> bool:
    return verdict_of(answer) is Verdict.KEPT


def _value(kappa: Measured | None) -> float | None:
    return kappa.value if kappa else None
