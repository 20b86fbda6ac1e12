"""Runs: one configuration applied to a whole dataset, in the background.

The work of a run is done outside of any transaction; then one transaction looks for
frames that came in meanwhile, stores what changed, and makes its verdicts current.
Nobody ever sees a dataset that is half decided.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
from sqlalchemy import event
from sqlalchemy.orm import Session

from app.db.base import utc_now
from app.db.tables import Dataset, Run
from app.repositories.datasets import DatasetRepository
from app.repositories.decisions import DecisionRepository
from app.repositories.evidence import EvidenceRepository
from app.repositories.runs import ConfigRepository, RunRepository
from app.repositories.tallies import TallyKey, TallyRepository
from app.services.configs import active_version, config_of
from app.services.context import ServiceContext
from app.services.numbers import DatasetNumbers
from app.services.run_measuring import RunCancelled, measure_missing
from filter_core.config import FilterConfig
from filter_core.decide import decide
from filter_core.errors import FilterError
from filter_core.types import BoolArray, Decisions, IntArray, Verdict

log = logging.getLogger(__name__)
_REASONS: Final = 32
"""More than there are reasons; they are packed into one number with flags."""


@dataclass(frozen=True)
class RunScope:
    """The identities of one run, read once."""

    run_id: int
    dataset_id: int
    measurement_id: int
    config: FilterConfig


def start_runs(context: ServiceContext) -> None:
    """Queue every run that is not finished; those that a crash cut off start anew."""
    with context.database.read() as session:
        waiting = [run.id for run in RunRepository(session).unfinished()]
    for run_id in waiting:
        context.engine.submit(partial(carry_out, context, run_id))


def start_after(context: ServiceContext, session: Session) -> None:
    """Start what this transaction has queued, once it is committed."""
    event.listen(session, "after_commit", lambda _: start_runs(context), once=True)


def carry_out(context: ServiceContext, run_id: int) -> None:
    """Do one run from its row to its end; safe to call again after a crash."""
    scope = _begin(context, run_id)
    if scope is None:
        return
    try:
        _finish(context, scope)
    except RunCancelled:
        log.info("run %d stops; it goes on when the service starts again", run_id)
    except FilterError as error:
        _fail(context, run_id, {"code": error.kind, "detail": error.detail})
    except Exception:
        _fail(context, run_id, {"code": "internal", "detail": "the run failed"})
        raise


def _begin(context: ServiceContext, run_id: int) -> RunScope | None:
    with context.database.write() as session:
        run = RunRepository(session).with_id(run_id)
        if run.state not in ("queued", "running"):
            return None
        run.state, run.started_at = "running", run.started_at or utc_now()
        config = config_of(ConfigRepository(session).with_id(run.config_id))
        session.flush()
        return RunScope(run.id, run.dataset_id, run.measurement_id or 0, config)


def _finish(context: ServiceContext, scope: RunScope) -> None:
    """Measure, decide and switch; repeated for frames that came in meanwhile."""
    while True:
        measure_missing(context, scope)
        # Loading a million numbers holds no lock; the transaction finds them cached.
        with context.database.read() as session:
            _numbers(context, session, scope)
        with context.database.write() as session:
            if measure_missing(context, scope, session=session) == 0:
                _store(context, session, scope)
                return


def _numbers(
    context: ServiceContext, session: Session, scope: RunScope
) -> DatasetNumbers:
    return context.numbers.load(session, scope.dataset_id, scope.measurement_id)


def _store(context: ServiceContext, session: Session, scope: RunScope) -> None:
    runs, datasets = RunRepository(session), DatasetRepository(session)
    run, dataset = runs.with_id(scope.run_id), datasets.with_id(scope.dataset_id)
    after_numbers = _numbers(context, session, scope)
    before_numbers = context.numbers.load(
        session, dataset.id, dataset.active_measurement_id or 0
    )
    before = before_numbers.decided(config_of(active_version(session, dataset)))
    after = decide(after_numbers.evidence, scope.config)
    decisions = DecisionRepository(session)
    changed = _differs(before, after)
    flipped = before.reason != after.reason
    ids = after_numbers.box_ids
    decisions.record_flips(
        run.id, ids[flipped], before.reason[flipped], after.reason[flipped]
    )
    if run.activate:
        decisions.refresh(ids[changed], _part(before, changed), _part(after, changed))
        if before_numbers is not after_numbers:
            decisions.refresh_numbers(ids, after_numbers.evidence)
        _retally(session, dataset, after_numbers, after)
        dataset.active_config_id = run.config_id
        dataset.active_run_id = run.id
        dataset.active_measurement_id = scope.measurement_id
        measurement = EvidenceRepository(session).measurement_with_id(
            scope.measurement_id
        )
        datasets.change(dataset, measurement.options["dataset"])
    run.changed, run.done = int(flipped.sum()), run.total
    run.counts = {verdict.value: after.count(verdict) for verdict in Verdict}
    run.state, run.finished_at = "done", utc_now()
    session.flush()


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


def _fail(context: ServiceContext, run_id: int, error: Mapping[str, Any]) -> None:
    with context.database.write() as session:
        run: Run = RunRepository(session).with_id(run_id)
        run.state, run.finished_at, run.error = "failed", utc_now(), dict(error)
