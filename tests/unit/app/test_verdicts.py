"""Effective verdicts, conflicts and review states are the same in Python and SQL."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from sqlalchemy import and_, create_engine, insert, select

from app.db.base import Base
from app.db.tables import Decision
from app.verdicts import (
    REVIEW_STATES,
    effective_verdict,
    in_conflict,
    is_effective,
    is_in_conflict,
    is_not_in_conflict,
    needs_review,
)
from filter_core.types import VERDICTS, Answer, Reason, Verdict
from tests.support.exporting import columns

ANSWERS = (None, "keep", "reject", "unsure")
BOXES = list(product(Reason, ANSWERS))
"""Every reason with every answer; the number of a box is its index here."""


@pytest.fixture(scope="module")
def boxes_matching():
    """A function that returns the numbers of the boxes that match an SQL condition."""
    engine = create_engine("sqlite://")
    table = Base.metadata.tables[Decision.__tablename__]
    table.create(engine)
    rows = [
        {"box_id": number, "reason": int(reason), "review": answer}
        for number, (reason, answer) in enumerate(BOXES)
    ]
    same: dict[str, object] = {
        column.name: 0
        for column in table.columns
        if not column.nullable and column.name not in rows[0]
    }
    with engine.begin() as connection:
        connection.execute(insert(table), [{**row, **same} for row in rows])

        def found(condition):
            return set(connection.scalars(select(table.c.box_id).where(condition)))

        yield found
    engine.dispose()


@pytest.mark.parametrize("verdict", Verdict)
def test_effective_verdict_is_equal_in_python_columns_and_sql(boxes_matching, verdict):
    codes = [Answer[(answer or "none").upper()] for _, answer in BOXES]
    boxes = replace(
        columns([]),
        reason=np.array([reason for reason, _ in BOXES], np.uint8),
        answer=np.array(codes, np.uint8),
    )

    expected = {
        number
        for number, (reason, answer) in enumerate(BOXES)
        if effective_verdict(reason, answer) == verdict.value
    }

    assert expected
    assert boxes_matching(is_effective(verdict)) == expected
    code = VERDICTS.index(verdict)
    assert set(np.flatnonzero(boxes.effective == code).tolist()) == expected


def test_conflict_is_equal_in_python_and_sql(boxes_matching):
    expected = {
        number
        for number, (reason, answer) in enumerate(BOXES)
        if in_conflict(reason, answer)
    }

    assert expected
    assert boxes_matching(is_in_conflict()) == expected
    assert boxes_matching(is_not_in_conflict()) == set(range(len(BOXES))) - expected


@pytest.mark.parametrize("toss_up", [False, True])
def test_box_needs_review_if_undecided_and_the_filter_is_unsure(
    boxes_matching, toss_up
):
    sure = {Reason.OUTSIDE_IMAGE, Reason.DEGENERATE} | (
        set() if toss_up else {Reason.VISIBLE}
    )
    unsure = Decision.reason.not_in([int(reason) for reason in sure])
    undecided = REVIEW_STATES["undecided"].condition()

    found = {
        number
        for number, (reason, answer) in enumerate(BOXES)
        if needs_review(reason, toss_up, answer)
    }

    assert found
    assert boxes_matching(and_(undecided, unsure)) == found


@pytest.mark.parametrize("name", REVIEW_STATES)
def test_review_state_is_equal_by_its_answers_and_in_sql(boxes_matching, name):
    state = REVIEW_STATES[name]

    expected = {
        number
        for number, (_, answer) in enumerate(BOXES)
        if (answer or "") in state.answers
    }

    assert boxes_matching(state.condition()) == expected
    if state.others is not None:
        others = boxes_matching(REVIEW_STATES[state.others].condition())
        assert others == set(range(len(BOXES))) - expected
