"""The end of a run: one transaction that stores what changed and makes it current."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from sqlalchemy.orm import Session

from app.db.base import utc_now
from app.db.tables import Dataset, Run
from app.engine import LocalEngine
from app.repositories.datasets import DatasetRepository
from app.repositories.decisions import DecisionRepository
from app.repositories.evidence import EvidenceRepository
from app.repositories.tallies import TallyKey, TallyRepository
from app.services.configs import active_version, config_of
from app.services.context import ServiceContext
from app.services.numbers import DatasetNumbers
from app.services.run_states import job_of
from filter_core.config import FilterConfig
from filter_core.decide import decide
from filter_core.types import BoolArray, Decisions, IntArray, Verdict

_REASONS: Final = 32
"""More than there are reasons; they are packed into one number with flags."""


@dataclass(frozen=True)
class BeforeAndAfter:
    """Numbers that are current now, and those that a run decides on."""

    before: DatasetNumbers
    after: DatasetNumbers

    @classmethod
    def load(
        cls, context: ServiceContext, session: Session, run: Run
    ) -> BeforeAndAfter:
        """From memory where they are; from the database else."""
        dataset = DatasetRepository(session).with_id(run.dataset_id)
        before, after = (
            context.numbers.load(session, dataset.id, measurement or 0)
            for measurement in (dataset.active_measurement_id, run.measurement_id)
        )
        return cls(before, after)


def switch(
    context: ServiceContext, session: Session, run: Run, config: FilterConfig
) -> None:
    """Store flips and counts; if the run activates, make its verdicts current."""
    numbers = BeforeAndAfter.load(context, session, run)
    dataset = DatasetRepository(session).with_id(run.dataset_id)
    before = numbers.before.decided(config_of(active_version(session, dataset)))
    after = decide(numbers.after.evidence, config)
    ids, flipped = numbers.after.box_ids, before.reason != after.reason
    DecisionRepository(session).record_flips(
        run.id, ids[flipped], before.reason[flipped], after.reason[flipped]
    )
    run.previous_run_id = dataset.active_run_id
    if run.activate:
        _refresh(context.engine, session, run, numbers, (before, after))
        _retally(session, dataset, numbers.after, after)
        _activate(session, dataset, run)
    run.changed, run.done = int(flipped.sum()), run.total
    run.counts = {verdict.value: after.count(verdict) for verdict in Verdict}
    run.state, run.finished_at = "done", utc_now()
    session.flush()


def _refresh(
    engine: LocalEngine,
    session: Session,
    run: Run,
    numbers: BeforeAndAfter,
    decisions: tuple[Decisions, Decisions],
) -> None:
    before, after = decisions
    repository, ids = DecisionRepository(session), numbers.after.box_ids
    changed = _differs(before, after)
    measured_anew = numbers.before is not numbers.after
    rows = int(changed.sum()) + (len(ids) if measured_anew else 0)
    progress = _Progress(engine, run, rows)
    repository.refresh(
        ids[changed], _part(before, changed), _part(after, changed), progress
    )
    if measured_anew:
        repository.refresh_numbers(ids, numbers.after.evidence, progress)


@dataclass
class _Progress:
    """Called with rows as they are written: says how far it is, and may end it."""

    engine: LocalEngine
    run: Run
    rows: int
    written: int = field(default=0)

    def __call__(self, rows: int) -> None:
        job = job_of(self.run.id)
        self.engine.check(job)
        self.written += rows
        self.engine.report(job, self.run.total * self.written // max(self.rows, 1))


def _activate(session: Session, dataset: Dataset, run: Run) -> None:
    dataset.active_config_id = run.config_id
    dataset.active_run_id = run.id
    dataset.active_measurement_id = run.measurement_id
    measurement = EvidenceRepository(session).measurement_with_id(
        run.measurement_id or 0
    )
    DatasetRepository(session).change(dataset, measurement.options["dataset"])


def _differs(before: Decisions, after: Decisions) -> BoolArray:
    different: BoolArray = (
        (before.reason != after.reason)
        | (before.toss_up != after.toss_up)
        | (before.large != after.large)
    )
    return different


def _part(decisions: Decisions, rows: BoolArray) -> Decisions:
    return Decisions(
        reason=decisions.reason[rows],
        threshold=decisions.threshold[rows],
        margin=decisions.margin[rows],
        toss_up=decisions.toss_up[rows],
        large=decisions.large[rows],
    )


def _retally(
    session: Session, dataset: Dataset, numbers: DatasetNumbers, decisions: Decisions
) -> None:
    """Count everything anew: cheaper, and surer, than counting what changed."""
    tallies = TallyRepository(session)
    reviewed = tallies.reviewed(dataset.id)
    at = np.searchsorted(numbers.box_ids, [box_id for box_id, _ in reviewed])
    plain = np.ones(len(numbers), np.bool_)
    plain[at] = False
    counts = _count_alike(numbers.class_ids[plain], decisions, plain)
    for (_, review), row in zip(reviewed, at.tolist(), strict=True):
        key = TallyKey(
            int(numbers.class_ids[row]),
            int(decisions.reason[row]),
            bool(decisions.toss_up[row]),
            review,
        )
        counts[key] = counts.get(key, 0) + 1
    tallies.replace(dataset.id, counts)


def _count_alike(
    class_ids: IntArray, decisions: Decisions, rows: BoolArray
) -> dict[TallyKey, int]:
    packed = (class_ids * _REASONS + decisions.reason[rows]) * 2 + decisions.toss_up[
        rows
    ]
    keys, counts = np.unique(packed, return_counts=True)
    return {
        TallyKey(key // 2 // _REASONS, key // 2 % _REASONS, bool(key % 2), ""): boxes
        for key, boxes in zip(keys.tolist(), counts.tolist(), strict=True)
    }
