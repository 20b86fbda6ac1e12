"""The random sample of a dataset's boxes, and what it says about the filter.

The queue shows boxes in the random order of the dataset (`app.boxes.shuffle`), and each
answer keeps the place that its box had in it (`probability`). How far people have come,
for each class, is the greatest of these places: the sample are all boxes up to there.
An answer counts by the place of its box, not by how it was given. So neither an answer
that was given in another view, nor one that was sent late, nor a client that claims
what it likes can make the sample another one: what is missing in it is counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from sqlalchemy.orm import Session

from app.boxes.filter import to_filter
from app.boxes.shuffle import Shuffle, shuffle_of
from app.boxes.truth import places_in
from app.catalog.datasets import DatasetRepository
from app.context import ServiceContext
from app.db.base import MAX_ID
from app.db.tables import Dataset
from app.measuring.active import active_config
from app.measuring.columns import ColumnCache, DatasetColumns
from app.measuring.plan import active_measurement
from app.quality.queries import AnsweredBox, AnswerRepository
from filter_core.arrays import FloatArray, IntArray
from filter_core.evaluation.sampling import (
    NARROW,
    WIDEST,
    Estimate,
    Part,
    Said,
    count_answers,
    estimate,
    plan,
)
from filter_core.evaluation.scores import BANDS, band_index
from filter_core.verdicts import UNMEASURED, VERDICT_OF_REASON, Reason
from unghost.wire.boxes import BoxSelection
from unghost.wire.quality import Plan, Sample

_SAID: Final = {"reject": Said.REJECT, "keep": Said.KEEP, "unsure": Said.UNSURE}
_IN_IMAGE: Final = np.array([False, *(reason.in_image for reason in Reason)])
"""Whether people can judge a box, by the number of its reason."""


@dataclass(frozen=True, eq=False)
class RandomSample:
    """Boxes that the filter decided and people can judge, C classes of them.

    `table` (C, bands, 2, 3, 4) int64 counts them by class, band of distance, verdict,
    `Part` and `Said`. `reach` (C,) float64 is the part of the random order that people
    have come to, 0..1.
    """

    table: IntArray
    reach: FloatArray

    @classmethod
    def of(
        cls, context: ServiceContext, session: Session, dataset: Dataset
    ) -> RandomSample:
        """The sample of a dataset as people have answered it until now."""
        shuffle = shuffle_of(session, dataset.id)
        reach, begun = _walk(session, dataset, shuffle)
        answers = AnswerRepository(session).answered(dataset.id)
        measurement = active_measurement(session, dataset)
        cache, config = context.one(ColumnCache), active_config(session, dataset)
        shape = (len(reach), len(BANDS), 2, len(Part), len(Said))
        table = np.zeros(shape, np.int64)
        for (numbers,) in cache.parts(session, dataset.id, measurement.id):
            reason = numbers.decided(config).reason
            judged = _IN_IMAGE[reason] & (VERDICT_OF_REASON[reason] != UNMEASURED)
            classes = numbers.evidence.class_index
            group = classes * len(BANDS) + band_index(numbers.evidence.distance)
            said, answer_id = _said(numbers, answers)
            shares = shuffle.shares_of(numbers.box_ids) if shuffle else np.empty(0)
            part = np.where(shares <= reach[classes], Part.SAMPLE, Part.REST)
            is_decided = (said == Said.KEEP) | (said == Said.REJECT)
            part[is_decided & (answer_id < begun[classes])] = Part.BEFORE
            counted = count_answers(
                group[judged],
                (reason == Reason.VISIBLE)[judged],
                part[judged],
                said[judged],
                groups=shape[0] * shape[1],
            )
            table += counted.reshape(shape)
        return cls(table, reach)

    def estimate(
        self, classes: slice = slice(None), bands: slice = slice(None)
    ) -> Estimate:
        """The scores on some of these boxes."""
        return estimate(self._strata(classes, bands))

    def has_answers(
        self, classes: slice = slice(None), bands: slice = slice(None)
    ) -> bool:
        """Whether the sample has an answer on one of these boxes."""
        sample = self.table[classes, bands, :, Part.SAMPLE]
        return bool(sample[..., [Said.KEEP, Said.REJECT]].any())

    def described(self) -> Sample:
        """The sample in numbers."""
        parts = self.table.sum(axis=(0, 1, 2))
        said = parts[Part.SAMPLE]
        return Sample(
            boxes=int(parts.sum()),
            before=int(parts[Part.BEFORE].sum()),
            answered=int(said[Said.KEEP] + said[Said.REJECT]),
            unsure=int(said[Said.UNSURE]),
            unanswered=int(said[Said.NOTHING]),
        )

    def plan(self) -> Plan | None:
        """How many boxes the sample needs in all for narrower intervals.

        Those are of `WIDEST`, or of `NARROW` if they are as narrow as that already;
        None if no more answers are needed.
        """
        strata = self._strata()
        now = estimate(strata).half_width
        target = WIDEST if now > WIDEST else NARROW
        if now <= target:
            return None
        boxes, expected = plan(strata, target)
        return Plan(boxes=boxes, half_width=expected)

    def _strata(
        self, classes: slice = slice(None), bands: slice = slice(None)
    ) -> IntArray:
        """(G, 2, 3, 4): classes of which people have come equally far are one group."""
        places, group = np.unique(self.reach[classes], return_inverse=True)
        table = self.table[classes, bands].sum(axis=1)
        strata = np.zeros((len(places), *table.shape[1:]), np.int64)
        np.add.at(strata, group, table)
        return strata


def _walk(
    session: Session, dataset: Dataset, shuffle: Shuffle | None
) -> tuple[FloatArray, IntArray]:
    """How far people have come in the random order, for each class, and since when.

    The greatest place, (C,) float64: 0 for classes that nobody has answered in this
    order. The id of the first answer in it, (C,) int64: `MAX_ID` if there is none.
    """
    class_ids = list(DatasetRepository(session).classes(dataset.id).values())
    reach, begun = np.zeros(len(class_ids)), np.full(len(class_ids), MAX_ID)
    drawn = AnswerRepository(session).drawn(dataset.id)
    if not drawn or shuffle is None:
        return reach, begun
    shares = shuffle.shares_of(np.array([each.box_id for each in drawn], np.int64))
    chosen = {}
    for answer, share in zip(drawn, shares.tolist(), strict=True):
        if answer.probability != share:
            continue  # the order of a dataset changes when it has grown immensely
        filters = answer.chosen_from
        if filters not in chosen:
            selection = BoxSelection.model_validate_json(filters or "{}")
            of_filter = to_filter(session, dataset, selection).class_ids
            chosen[filters] = np.isin(
                class_ids, class_ids if of_filter is None else of_filter
            )
        rows = chosen[filters]
        reach[rows] = np.maximum(reach[rows], share)
        begun[rows] = np.minimum(begun[rows], answer.id)
    return reach, begun


def _said(
    numbers: DatasetColumns, answers: Sequence[AnsweredBox]
) -> tuple[IntArray, IntArray]:
    """What people said of each box, as `Said`, and the id of the latest answer."""
    said, answer_id = np.zeros((2, len(numbers)), np.int64)
    # Other boxes are in another part, or were stored after the numbers were read.
    box_ids = np.array([answer.box_id for answer in answers], np.int64)
    rows, is_here = places_in(numbers.box_ids, box_ids)
    reviews = [_SAID[answer.review or ""] for answer in answers]
    said[rows] = np.array(reviews)[is_here]
    answer_id[rows] = np.array([answer.id for answer in answers])[is_here]
    return said, answer_id
