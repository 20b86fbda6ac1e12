"""Compares the filter, people and kinds of evidence with the truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from sqlalchemy.orm import Session

from app.boxes.counts import count
from app.boxes.current import TallyRepository
from app.boxes.truth import KnownTruth, described
from app.catalog.datasets import DatasetRepository
from app.context import ServiceContext
from app.db.tables import Dataset, Run
from app.measuring.active import active_config
from app.measuring.columns import ColumnCache, DatasetColumns
from app.measuring.plan import active_measurement
from app.quality.queries import AnswerRepository
from app.quality.sample import RandomSample
from app.runs.service import RunRequest, coming_settings, request_run
from app.verdicts import verdict_of
from filter_core.arrays import BoolArray, IntArray
from filter_core.evaluation import comparison
from filter_core.evaluation.agreement import agreement
from filter_core.evaluation.sampling import WIDEST, half_width
from filter_core.evaluation.scores import BANDS, Measured, band_index
from filter_core.evaluation.thresholds import Goal, Judged, suggest_per_class
from filter_core.evidence_kinds import CHANNELS, SEMANTIC
from filter_core.verdicts import Verdict
from unghost.wire import quality as wire
from unghost.wire.words import Truth


def request_evaluation(
    context: ServiceContext, session: Session, dataset: Dataset, author: str
) -> Run:
    """Queue a run that measures every channel that the frames' files allow.

    Verdicts do not change: the configuration is the active one. From then on new frames
    are measured by every channel, too.
    """
    _, config = coming_settings(session, dataset)
    request = RunRequest(config, author, activate=True, channels=CHANNELS)
    return request_run(context, session, dataset, request)


def evaluation(
    context: ServiceContext, session: Session, dataset: Dataset, truth: Truth
) -> wire.Evaluation:
    """How often each measured channel is right, from stored numbers."""
    measurement = active_measurement(session, dataset)
    stored = measurement.options.get("channels") or {}
    channels = tuple(name for name in CHANNELS if name in stored.get("names", ()))
    compared = comparison.Evaluation(
        active_config(session, dataset), (SEMANTIC, *channels)
    )
    for numbers, rows, visible in _with_truth(context, session, dataset, truth):
        ids = {"box_id": numbers.box_ids[rows], "frame_id": numbers.frame_ids[rows]}

        def name_of(row: int, ids: Mapping[str, IntArray] = ids) -> dict[str, int]:
            return {name: int(of_boxes[row]) for name, of_boxes in ids.items()}

        evidence, frames = numbers.evidence.take(rows), len(np.unique(ids["frame_id"]))
        compared.add(evidence, visible, frames, name_of)
    missing = [name for name in CHANNELS if name not in channels]
    return wire.Evaluation.model_validate(
        {"truth": truth, "not_measured": missing, **compared.as_dict()}
    )


def _with_truth(
    context: ServiceContext, session: Session, dataset: Dataset, truth: Truth
) -> Iterator[tuple[DatasetColumns, IntArray, BoolArray]]:
    """The parts of a dataset, each with its boxes whose truth is known.

    Of each: all its boxes, the rows of those whose truth is known, (N,) int64, and
    whether their object is visible, (N,) bool: by its instance, or by the latest answer
    of a person.
    """
    known_truth = KnownTruth.of(session, dataset, truth)
    measurement = active_measurement(session, dataset)
    cache = context.one(ColumnCache)
    for (numbers,) in cache.parts(session, dataset.id, measurement.id):
        yield numbers, *known_truth.rows(numbers)


def quality(
    context: ServiceContext,
    session: Session,
    dataset: Dataset,
    truth_and_goal: tuple[Truth, Goal],
) -> wire.Quality:
    """The filter compared with the truth, and people compared with each other."""
    truth, goal = truth_and_goal
    config = active_config(session, dataset)
    total, parts = 0, []
    for numbers, rows, visible in _with_truth(context, session, dataset, truth):
        total += len(rows)
        parts.append(Judged.of(numbers.evidence.take(rows), config, visible))
    judged = Judged.joined(parts)
    names = DatasetRepository(session).classes(dataset.id)
    classes = {name: index for index, name in enumerate(names)}
    rows_of = {name: judged.class_key == index for name, index in classes.items()}
    bands = band_index(judged.distance)
    sample = RandomSample.of(context, session, dataset) if truth == "people" else None
    counts = count(TallyRepository(session).of_dataset(dataset.id))
    panel = Panel.of(session, dataset.id)
    return wire.Quality(
        truth=truth,
        reviewed=counts.reviewed,
        unsure=counts.unsure,
        unmeasured=total - len(judged),
        sample=sample and sample.described(),
        plan=sample and sample.plan(),
        confusion=_counted(judged, sample),
        by_class={
            name: _counted(judged.where(rows), sample, classes=_only(classes[name]))
            for name, rows in rows_of.items()
            if rows.any()
        },
        by_distance=tuple(
            wire.Band(band=name, **dict(_counted(of_band, sample, bands=_only(place))))
            for place, name in enumerate(BANDS)
            for of_band in [judged.where(bands == place)]
        ),
        reviewers=panel.reviewers(),
        agreement=panel.agreement(),
        suggested=tuple(
            wire.Suggestion.model_validate(suggestion.as_dict())
            for suggestion in suggest_per_class(judged, classes, config, goal)
        ),
    )


_ALL: Final = slice(None)
_SCORES: Final = ("precision", "recall", "f1")


def _counted(
    judged: Judged,
    sample: RandomSample | None,
    classes: slice = _ALL,
    bands: slice = _ALL,
) -> wire.Confusion:
    """Counts of boxes whose truth is known, and scores: estimates, with a sample.

    Without a sample the counted boxes are all that there are, and so are the scores.
    """
    counted = described(judged.confusion)
    if sample is None:
        return counted
    estimate = sample.estimate(classes, bands)
    scores: dict[str, wire.Measure | None] = {}
    for name in _SCORES:
        score: Measured | None = getattr(estimate, name)
        can_tell = score is not None and half_width(score) <= WIDEST
        scores[name] = wire.Measure(**score.as_dict()) if score and can_tell else None
    refused = None
    if None in scores.values():
        has_some = sample.has_answers(classes, bands)
        refused = "too_few_random_answers" if has_some else "no_random_answers"
    return counted.model_copy(update={**scores, "refused": refused})


def _only(place: int) -> slice:
    return slice(place, place + 1)


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
        in_force = {key: said for key, said in latest.items() if said != "clear"}
        return cls(in_force)

    def reviewers(self) -> tuple[wire.Reviewer, ...]:
        """How many boxes each reviewer answered, and how; the most active first."""
        counts = Counter((who, verdict) for (_, who), verdict in self.latest.items())
        totals = Counter(who for _, who in self.latest)
        return tuple(
            wire.Reviewer(
                name=who,
                answers=total,
                keep=counts[who, "keep"],
                reject=counts[who, "reject"],
                unsure=counts[who, "unsure"],
            )
            for who, total in sorted(
                totals.items(), key=lambda pair: (-pair[1], pair[0])
            )
        )

    def agreement(self) -> wire.Agreement:
        """How far reviewers agree on boxes that several of them decided."""
        decided = [
            (box, who, verdict_of(verdict) is Verdict.KEPT)
            for (box, who), verdict in self.latest.items()
            if verdict_of(verdict) is not None
        ]
        names = sorted({who for _, who, _ in decided})
        place = {name: index for index, name in enumerate(names)}
        panel_agreement = agreement(
            np.array([box for box, _, _ in decided], np.int64),
            np.array([place[who] for _, who, _ in decided], np.int64),
            np.array([keep for _, _, keep in decided], np.bool_),
        )
        kappa = panel_agreement.kappa
        return wire.Agreement(
            boxes=panel_agreement.boxes,
            agreed=panel_agreement.agreed,
            percent=100 * panel_agreement.agreed / panel_agreement.boxes
            if panel_agreement.boxes
            else None,
            kappa=_value(kappa),
            interval=(kappa.low, kappa.high) if kappa else None,
            pairs=tuple(
                wire.Pair(
                    a=names[pair.a],
                    b=names[pair.b],
                    boxes=pair.boxes,
                    agreed=pair.agreed,
                    kappa=_value(pair.kappa),
                )
                for pair in panel_agreement.pairs
            ),
        )


def _value(kappa: Measured | None) -> float | None:
    return kappa.value if kappa else None
