"""The boxes of a dataset whose truth is known: by instance images, or by answers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from sqlalchemy.orm import Session

from app.boxes.queries import LatestAnswers
from app.db.tables import Dataset
from app.measuring.columns import DatasetColumns
from filter_core.arrays import BoolArray, IntArray
from filter_core.evaluation.comparison import truth_from_instances
from filter_core.evaluation.scores import Confusion
from unghost.wire import quality as wire
from unghost.wire.words import Truth


@dataclass(frozen=True)
class KnownTruth:
    """Whether the objects of boxes are visible, where that is known.

    `truth` is ``instances``: whether the object has a pixel in the instance image; or
    ``people``: the latest answer on a box, if it is keep or reject. Then `box_ids`
    (N,) are the answered boxes, ascending, and `keep` (N,) their answers.
    """

    truth: Truth
    box_ids: IntArray
    keep: BoolArray

    @classmethod
    def of(cls, session: Session, dataset: Dataset, truth: Truth) -> KnownTruth:
        """The truth of a dataset's boxes."""
        people = truth == "people"
        answers = LatestAnswers(session).decided(dataset.id) if people else {}
        return cls(
            truth,
            np.array(list(answers), np.int64),
            np.array(list(answers.values()), np.bool_),
        )

    def rows(self, numbers: DatasetColumns) -> tuple[IntArray, BoolArray]:
        """Rows (M,) of a part's boxes whose truth is known; (M,): are they visible."""
        if self.truth == "instances":
            return truth_from_instances(numbers.evidence)
        # Other boxes are in another part, or were stored after the numbers were read.
        rows, is_here = places_in(numbers.box_ids, self.box_ids)
        return rows, self.keep[is_here]


def places_in(box_ids: IntArray, some: IntArray) -> tuple[IntArray, BoolArray]:
    """Find boxes in an ascending list.

    (M,) int64: the places of those that the list has; (len(some),) bool: which these
    are.
    """
    places = np.searchsorted(box_ids, some)
    is_there: BoolArray = places < len(box_ids)
    is_there[is_there] = box_ids[places[is_there]] == some[is_there]
    return places[is_there].astype(np.int64), is_there


def described(scores: Confusion) -> wire.Confusion:
    """Counts, with the names of the wire: those for answers as the truth."""
    values = scores.as_dict()
    return wire.Confusion(
        kept_keep=values["kept_visible"],
        kept_reject=values["kept_hidden"],
        rejected_keep=values["rejected_visible"],
        rejected_reject=values["rejected_hidden"],
        precision=values["precision"],
        recall=values["recall"],
        f1=values["f1"],
        refused=None,
    )
