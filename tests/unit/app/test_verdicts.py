"""Effective verdicts, conflicts and review states are the same in Python and SQL."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from sqlalchemy import create_engine, insert, select

from app.db.base import Base
from app.db.tables import Decision
from app.verdicts import (
    BIN,
    REVIEW_STATES,
    effective_verdict,
    in_bin,
    in_conflict,
    is_effective,
    is_in_conflict,
    is_not_in_conflict,
)
from filter_core.decisions.doubt import Bin, bins_of
from filter_core.verdicts import VERDICTS, Answer, Reason, Verdict
from tests.support.exporting import columns

ANSWERS = (None, "keep", "reject", "unsure")
BOXES = list(product(Reason, ANSWERS))
"""Every reason with every answer; the number of a box is its index here."""
DOUBTS = [(-2, -1, 0, 1, 50, 100)[number % 6] for number in range(len(BOXES))]


@pytest.fixture(scope="module")
def boxes_matching():
    """A function that returns the numbers of the boxes that match an SQL condition."""
    engine = create_engine("sqlite://")
    table = Base.metadata.tables[Decision.__tablename__]
    table.create(engine)
    rows = [
        {"box_id": number, "reason": int(reason), "review": answer, "doubt": doubt}
        for number, ((reason, answer), doubt) in enumerate(
            zip(BOXES, DOUBTS, strict=True)
        )
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


ROWS = [(*box, np.int16(doubt)) for box, doubt in zip(BOXES, DOUBTS, strict=True)]


def numbers_where(is_true):
    """The numbers of the boxes of which it is true, by reason, answer and doubt."""
    return {number for number, row in enumerate(ROWS) if is_true(*row)}


@pytest.mark.parametrize("verdict", Verdict)
def test_effective_verdict_is_equal_in_python_columns_and_sql(boxes_matching, verdict):
    codes = [Answer[(answer or "none").upper()] for _, answer in BOXES]
    boxes = replace(
        columns([]),
        reason=np.array([reason for reason, _ in BOXES], np.uint8),
        answer=np.array(codes, np.uint8),
    )

    expected = numbers_where(lambda *row: effective_verdict(*row[:2]) == verdict.value)

    assert expected
    assert boxes_matching(is_effective(verdict)) == expected
    code = VERDICTS.index(verdict)
    assert set(np.flatnonzero(boxes.effective == code).tolist()) == expected


def test_conflict_is_equal_in_python_and_sql(boxes_matching):
    expected = numbers_where(lambda *row: in_conflict(*row[:2]))

    assert expected
    assert boxes_matching(is_in_conflict()) == expected
    assert boxes_matching(is_not_in_conflict()) == set(range(len(BOXES))) - expected


@pytest.mark.parametrize("bin_", Bin)
def test_bin_of_a_box_is_equal_in_python_and_sql(boxes_matching, bin_):
    expected = numbers_where(lambda *row: bins_of(row[2]) == bin_)

    assert expected
    assert boxes_matching(in_bin(bin_)) == expected
    assert boxes_matching(int(bin_) == BIN) == expected


@pytest.mark.parametrize("name", REVIEW_STATES)
def test_review_state_is_equal_by_its_answers_and_in_sql(boxes_matching, name):
    state = REVIEW_STATES[name]

    expected = numbers_where(lambda *row: (row[1] or "") in state.answers)

    assert boxes_matching(state.condition()) == expected
    if state.others is not None:
        others = boxes_matching(REVIEW_STATES[state.others].condition())
        assert others == set(range(len(BOXES))) - expected
