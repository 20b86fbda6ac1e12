"""How many boxes a filter selects, exactly: from tallies if they can tell.

Ranges of numbers are counted in the numbers that are held in memory, less those boxes
that people answered, which are few and have an index.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.db.tables import Dataset
from app.repositories.box_filter import BoxFilter
from app.repositories.box_probes import BoxProbes
from app.repositories.tallies import TallyKey, TallyRepository
from app.services.configs import active_version, config_of
from app.services.number_filter import selected
from app.services.numbers import DatasetNumbers, NumbersCache
from app.services.run_requests import active_measurement
from app.verdicts import REVIEW_STATES, effective_verdict, in_conflict
from filter_core.config.filter import FilterConfig


def count_boxes(
    context: ServiceContext, session: Session, dataset: Dataset, wanted: BoxFilter
) -> int:
    """The exact number of boxes of a filter."""
    tallies = TallyRepository(session).of_dataset(wanted.dataset_id)
    most = count_alike(tallies, wanted)
    if not wanted.has_ranges or not most:
        return most
    by_numbers = wanted.effective is None and wanted.conflict is None
    held = by_numbers and context.one(NumbersCache).fits(session, dataset.id)
    # Boxes that somebody answered are few, and counted by their index; where all others
    # are asked for, they are all boxes less those.
    others = REVIEW_STATES[wanted.review].others if wanted.review else None
    if not held or (wanted.review and others is None):
        return BoxProbes(session).count(wanted)
    measurement = active_measurement(session, dataset)
    numbers = context.one(NumbersCache).load(session, dataset.id, measurement.id)
    config = config_of(active_version(session, dataset))
    unreviewed = replace(wanted, review="")
    whole = numbers.counted(
        (config.digest, unreviewed), lambda: _selected(numbers, config, unreviewed)
    )
    if others is None:
        return whole
    return whole - BoxProbes(session).count(replace(wanted, review=others))


def _selected(numbers: DatasetNumbers, config: FilterConfig, wanted: BoxFilter) -> int:
    chosen = selected(numbers, numbers.decided(config), wanted)
    return int(np.count_nonzero(chosen))


def count_alike(tallies: Mapping[TallyKey, int], wanted: BoxFilter) -> int:
    """What tallies know of a filter: all but its ranges, so no less than there are."""
    return sum(boxes for key, boxes in tallies.items() if selects(wanted, key))


def selects(wanted: BoxFilter, key: TallyKey) -> bool:
    """Whether a filter without ranges selects the boxes of this tally."""
    return (
        (not wanted.reasons or key.reason in wanted.reasons)
        and (wanted.class_ids is None or key.class_id in wanted.class_ids)
        and (wanted.toss_up is None or key.toss_up is wanted.toss_up)
        and _fits_answer(wanted, key)
    )


def _fits_answer(wanted: BoxFilter, key: TallyKey) -> bool:
    effective = effective_verdict(key.reason, key.review)
    conflict = in_conflict(key.reason, key.review)
    return (
        (not wanted.review or key.review in REVIEW_STATES[wanted.review].answers)
        and (wanted.effective is None or effective == wanted.effective.value)
        and (wanted.conflict is None or conflict is wanted.conflict)
    )
