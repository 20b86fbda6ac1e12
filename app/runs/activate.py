"""The final step of a run: one transaction that decides all boxes, and stores changes.

The boxes that get another reason are stored (`flips`); with `activate`, their new
decisions are, too.

Because it is one transaction, nobody ever sees half of a dataset decided. If its
process dies, nothing of it is stored, and the next driver begins it anew. It is a
chunk, so attempts are counted: after `MOST_ATTEMPTS` dead processes the run fails
(`app.jobs.attempts`). If two processes execute it, the second finds that the run has
ended and changes nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from sqlalchemy.orm import Session

from app.boxes import current
from app.boxes.filter import TallyKey
from app.boxes.queries import LatestAnswers
from app.catalog.datasets import DatasetRepository
from app.catalog.frames import frames_state
from app.context import ServiceContext
from app.db.base import filled
from app.db.tables import Run
from app.jobs.kind import Task
from app.measuring.active import active_config
from app.measuring.columns import ColumnCache, DatasetColumns
from app.measuring.queries import EvidenceRepository
from app.runs.flips import FlipTable
from app.runs.measure import RunScope, is_measured
from app.runs.queries import RunRepository
from filter_core.arrays import IntArray
from filter_core.config.filter import FilterConfig
from filter_core.decisions.doubt import Bin, bins_of, doubts
from filter_core.decisions.rules import decide

_REASONS: Final = 32
"""Greater than each `Reason`: `_count_unreviewed` packs all keys into one number."""


def parts_of(
    context: ServiceContext, session: Session, run: Run
) -> Iterator[tuple[DatasetColumns, ...]]:
    """The current numbers of each part of the dataset, and those of the run.

    Each part is small enough to be held in memory.
    """
    dataset = DatasetRepository(session).with_id(run.dataset_id)
    both = filled(dataset.active_measurement_id), filled(run.measurement_id)
    return context.one(ColumnCache).parts(session, dataset.id, *both)


def decide_all(task: Task[Run]) -> None:
    """Decide all boxes of a run and end it, unless there are new frames to measure.

    Raises JobStopped: the run has ended, or is being cancelled.
    """
    context = task.context
    # This only loads the boxes into the cache, so that below no lock is held while a
    # million numbers are loaded.
    with context.database.read() as session:
        run = task.row(session)
        if context.one(ColumnCache).fits(session, run.dataset_id):
            next(parts_of(context, session, run))
    with context.database.write() as session:
        run = task.row(session)
        scope = RunScope.of(session, run)
        if not is_measured(session, scope):
            # There are new frames to measure; earlier attempts no longer count.
            task.reset_attempts(session)
            return
        dataset = DatasetRepository(session).with_id(run.dataset_id)
        active = active_config(session, dataset)
        boxes = frames_state(session, dataset.id)[1]
        # The counts are stored, and in the table `flips` which boxes get another
        # reason. If the run activates, its verdicts become current.
        decider = RunDecider(session, run, _Progress(task, run.total, boxes))
        for former, numbers in parts_of(context, session, run):
            decider.decide(former, numbers, active, scope.config)
        run.previous_run_id = dataset.active_run_id
        if run.activate:
            current.replace_tallies(session, dataset.id, decider.tallies)
            measurement = EvidenceRepository(session).measurement_with_id(
                scope.measurement_id
            )
            datasets = DatasetRepository(session)
            datasets.activate(dataset, run)
            reading, before = measurement.options["dataset"], dataset.renamed_classes
            renamed = reading.get("renamed_classes", {})
            datasets.change(dataset, reading)
            changed = {
                name: now for name, now in renamed.items() if before.get(name) != now
            }
            datasets.rename_classes(dataset.id, changed)
        run.changed, run.done = decider.flips.changed, run.total
        run.counts = decider.flips.verdicts()
        run.last_review_id = LatestAnswers(session).newest_id()
        task.end_job(session)


def refresh_doubt(context: ServiceContext) -> None:
    """Compute stored doubt again where another version of this code has computed it.

    After an upgrade, before the first request. Each dataset is a transaction.
    """
    with context.database.read() as session:
        datasets = DatasetRepository(session).with_other_doubt()
        names = [dataset.name for dataset in datasets]
    for name in names:
        with context.database.write() as session:
            dataset = DatasetRepository(session).named(name)
            config = active_config(session, dataset)
            measurement = filled(dataset.active_measurement_id)
            cache = context.one(ColumnCache)
            for (numbers,) in cache.parts(session, dataset.id, measurement):
                current.doubt_again(session, numbers.box_ids, numbers.doubt(config))
            current.recount_tallies(session, dataset.id)
            DatasetRepository(session).has_this_doubt(dataset)


class RunDecider:
    """Stores which boxes a run changes, part by part, in memory of a constant size.

    It counts them, and writes new decisions only if the run is to be activated.
    """

    def __init__(self, session: Session, run: Run, progress: _Progress) -> None:
        self._session, self._run, self._progress = session, run, progress
        classes = DatasetRepository(session).classes(run.dataset_id)
        self.flips = FlipTable(tuple(classes))
        self.tallies: Counter[TallyKey] = Counter()
        reviewed = current.DecisionRepository(session).reviewed(run.dataset_id)
        self._reviewed = np.array([box_id for box_id, _ in reviewed], np.int64)
        self._reviews = [review for _, review in reviewed]

    def decide(
        self,
        former: DatasetColumns,
        numbers: DatasetColumns,
        active: FilterConfig,
        config: FilterConfig,
    ) -> None:
        """Decide a part by both configurations, and store the differences.

        If both are of one measurement, the cache gives the same object twice.
        """
        evidence = numbers.evidence
        before, after = former.decided(active), decide(evidence, config)
        ids, flipped = numbers.box_ids, before.reason != after.reason
        RunRepository(self._session).record_flips(
            self._run.id, ids[flipped], before.reason[flipped], after.reason[flipped]
        )
        self.flips.add(evidence, before.reason, after.reason)
        if not self._run.activate:
            return
        then = current.Decided.of(before, former.doubt(active))
        now = current.Decided.of(after, doubts(evidence, config, after).doubt)
        rows = int(then.differs(now).sum())
        rows += len(ids) if former is not numbers else 0
        self._progress.begin(len(ids), rows)
        current.decided_again(self._session, ids, then, now, self._progress)
        if former is not numbers:
            current.measured_again(self._session, ids, evidence, self._progress)
            moved = former.class_ids != numbers.class_ids
            current.classified_again(
                self._session, ids[moved], numbers.class_ids[moved]
            )
        if len(ids):
            self._tally(numbers, now)

    def _tally(self, numbers: DatasetColumns, decided: current.Decided) -> None:
        """Count all boxes, which is cheaper and safer than counting changes."""
        # All ids are in order. `_reviewed[here]` are the reviewed boxes of this part;
        # `rows` are their positions in it.
        first, last = numbers.box_ids[[0, -1]]
        here = slice(*np.searchsorted(self._reviewed, [first, last + 1]).tolist())
        rows = np.searchsorted(numbers.box_ids, self._reviewed[here])
        others = np.ones(len(numbers), np.bool_)
        others[rows] = False
        bins = bins_of(decided.doubt)
        keys = np.stack([numbers.class_ids, decided.reason, decided.toss_up, bins])
        self.tallies.update(_count_unreviewed(keys[:, others]))
        for review, key in zip(self._reviews[here], keys.T[rows].tolist(), strict=True):
            self.tallies[_tally_key(key, review)] += 1


@dataclass
class _Progress:
    """A callback for written rows: reports progress, raises if the job must stop."""

    task: Task[Run]
    total: int
    boxes: int
    _boxes_before: int = 0
    _boxes_in_part: int = 0
    _rows_in_part: int = 0
    _written: int = 0

    def begin(self, boxes: int, rows: int) -> None:
        """Begin a part of `boxes` boxes, for which `rows` rows are to be written."""
        self._boxes_before += self._boxes_in_part
        self._boxes_in_part = boxes
        self._rows_in_part, self._written = rows, 0
        self(0)

    def __call__(self, rows: int) -> None:
        self.task.check()
        self._written += rows
        of_part = self._boxes_in_part * self._written // max(self._rows_in_part, 1)
        boxes = self._boxes_before + of_part
        self.task.report(self.total * boxes // max(self.boxes, 1))


def _count_unreviewed(keys: IntArray) -> dict[TallyKey, int]:
    """Boxes by class, reason, flag and bin, the rows of `keys` (4, N)."""
    class_ids, reason, toss_up, bin_ = keys
    packed = ((class_ids * _REASONS + reason) * 2 + toss_up) * len(Bin) - bin_
    _, first, counts = np.unique(packed, return_index=True, return_counts=True)
    distinct = zip(keys.T[first].tolist(), counts.tolist(), strict=True)
    return {_tally_key(key, ""): boxes for key, boxes in distinct}


def _tally_key(key: Sequence[int], review: str) -> TallyKey:
    class_id, reason, toss_up, bin_ = key
    return TallyKey(class_id, reason, bool(toss_up), bin_, review)
