"""Reviewers: what each of them said last of each box, and how far they agree."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from sqlalchemy.orm import Session

from app.repositories.answers import AnswerRepository
from filter_core.evaluation.agreement import agreement
from filter_core.evaluation.scores import Measured
from unghost.wire.quality import Agreement, Pair, Reviewer


@dataclass(frozen=True)
class Panel:
    """The latest answer of each reviewer on each box; what was cleared is none."""

    latest: dict[tuple[int, str], str]

    @classmethod
    def of(cls, session: Session, dataset_id: int) -> Panel:
        """Of a dataset, as its answers stand.

        Taking a batch back says again what others had said before: no answer of one's
        own, and neither is what was taken back.
        """
        answers = AnswerRepository(session)
        ignored = answers.taken_back(dataset_id)
        latest = {
            (said.box_id, said.reviewer): said.verdict
            for said in answers.said(dataset_id)
            if said.batch_id not in ignored
        }
        return cls({key: said for key, said in latest.items() if said != "clear"})

    def reviewers(self) -> tuple[Reviewer, ...]:
        """How many boxes each of them answered, and how; the busiest first."""
        counts = Counter((who, said) for (_, who), said in self.latest.items())
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
        """How far those agree who decided the same boxes."""
        decided = [
            (box, who, said == "keep")
            for (box, who), said in self.latest.items()
            if said != "unsure"
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


def _value(kappa: Measured | None) -> float | None:
    return kappa.value if kappa else None
