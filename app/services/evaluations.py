"""Channels compared with what is true: measured by a run, counted from its numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.db.tables import Dataset, Run
from app.repositories.answers import AnswerRepository
from app.services.configs import active_version, config_of
from app.services.numbers import DatasetNumbers, NumbersCache
from app.services.run_requests import (
    RunRequest,
    active_measurement,
    coming_settings,
    request_run,
)
from filter_core.config.keys import CHANNELS, SEMANTIC
from filter_core.evaluation import comparison
from filter_core.evaluation.comparison import truth_from_instances
from filter_core.types import BoolArray, IntArray
from unghost.wire.quality import Evaluation
from unghost.wire.words import Truth

_KEEP: Final = "keep"


def request_evaluation(
    context: ServiceContext, session: Session, dataset: Dataset, author: str
) -> Run:
    """Queue a run that measures every channel that the frames' files allow.

    Verdicts stay as they are: the configuration is the active one. From then on new
    frames are measured under every channel, too.
    """
    _, config = coming_settings(session, dataset)
    wanted = RunRequest(config, author, activate=True, channels=CHANNELS)
    return request_run(context, session, dataset, wanted)


def evaluation(
    context: ServiceContext, session: Session, dataset: Dataset, truth: Truth
) -> Evaluation:
    """What each measured channel gets right, by the numbers at hand."""
    measurement = active_measurement(session, dataset)
    stored = measurement.options.get("channels") or {}
    channels = tuple(name for name in CHANNELS if name in stored.get("names", ()))
    compared = comparison.Evaluation(
        config_of(active_version(session, dataset)), (SEMANTIC, *channels)
    )
    truth_of = _by_people(session, dataset) if truth == "people" else _by_instances
    cache = context.one(NumbersCache)
    for (numbers,) in cache.parts(session, dataset.id, measurement.id):
        _compare(compared, numbers, *truth_of(numbers))
    missing = [name for name in CHANNELS if name not in channels]
    return Evaluation.model_validate(
        {"truth": truth, "not_measured": missing, **compared.as_dict()}
    )


def _compare(
    compared: comparison.Evaluation,
    numbers: DatasetNumbers,
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


def _by_instances(numbers: DatasetNumbers) -> tuple[IntArray, BoolArray]:
    return truth_from_instances(numbers.evidence)


def _by_people(
    session: Session, dataset: Dataset
) -> Callable[[DatasetNumbers], tuple[IntArray, BoolArray]]:
    """Finds the boxes whose latest answer is keep or reject, and what it is."""
    answered = AnswerRepository(session).decided(dataset.id)
    box_ids = np.array([box.box_id for box in answered], np.int64)
    keep = np.array([box.review == _KEEP for box in answered], np.bool_)

    def truth_of(numbers: DatasetNumbers) -> tuple[IntArray, BoolArray]:
        rows = np.searchsorted(numbers.box_ids, box_ids)
        # Of another part, or of a frame that came after the numbers were read.
        known = rows < len(numbers)
        known[known] = numbers.box_ids[rows[known]] == box_ids[known]
        return rows[known].astype(np.int64), keep[known]

    return truth_of
