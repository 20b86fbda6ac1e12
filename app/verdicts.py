"""What counts for a box: the filter's verdict, or what a person said of it.

Here it is said twice: in Python, for one box, and in SQL, for lists. For arrays the
library says it (`DecidedBoxes.effective`). `tests/unit/app/test_verdicts.py` compares
the three over every reason and answer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from sqlalchemy import ColumnElement, and_, or_

from app.db.tables import Decision
from filter_core.types import Reason, Verdict
from unghost.wire import words

NOTHING_TO_SEE: Final = frozenset({Reason.OUTSIDE_IMAGE, Reason.DEGENERATE})
"""Rejected by geometry alone: a picture could not change anybody's mind."""
_SAID: Final[Mapping[str, Verdict]] = {"keep": Verdict.KEPT, "reject": Verdict.REJECTED}
"""The verdict that an answer puts in the place of the filter's; others put none."""


def effective_verdict(reason: int, answer: str | None) -> words.Verdict:
    """A person's keep or reject counts; without one, the filter's verdict."""
    return with_answer(Reason(reason).verdict.value, answer)


def with_answer(verdict: words.Verdict, answer: str | None) -> words.Verdict:
    """What counts for a box that the filter gave this verdict."""
    said = said_verdict(answer)
    return verdict if said is None else said.value


def said_verdict(answer: str | None) -> Verdict | None:
    """The verdict that a person gave; None for any answer but keep and reject."""
    return _SAID.get(answer or "")


def is_effective(verdict: Verdict) -> ColumnElement[bool]:
    """Current decisions whose effective verdict is this one."""
    by_filter = and_(_undecided(), Decision.reason.in_(reasons_of(verdict)))
    for answer, said in _SAID.items():
        if said is verdict:
            return or_(Decision.review == answer, by_filter)
    return by_filter


def reasons_of(verdict: Verdict) -> tuple[int, ...]:
    """The reasons that give this verdict."""
    return tuple(int(reason) for reason in Reason if reason.verdict is verdict)


def in_conflict(reason: int, answer: str | None) -> bool:
    """A person's keep or reject says the opposite of the filter.

    An answer on a box that was not measured contradicts nothing.
    """
    said, verdict = said_verdict(answer), Reason(reason).verdict
    return verdict in _SAID.values() and said is not None and said is not verdict


def is_in_conflict() -> ColumnElement[bool]:
    """Current decisions that a person contradicts."""
    # Said first and alone, for the index on boxes that were answered.
    return and_(Decision.review.in_(tuple(_SAID)), or_(*_contradicting()))


def is_not_in_conflict() -> ColumnElement[bool]:
    """Current decisions that nobody contradicts, answered or not."""
    # Not `not_`: of a box without an answer that would be unknown, and leave it out.
    kept, rejected = reasons_of(Verdict.KEPT), reasons_of(Verdict.REJECTED)
    return or_(
        _undecided(),
        and_(Decision.review == "keep", Decision.reason.not_in(rejected)),
        and_(Decision.review == "reject", Decision.reason.not_in(kept)),
    )


def needs_review(reason: int, toss_up: bool, answer: str | None) -> bool:
    """Whether a person should look: nobody has decided, and the filter is not sure.

    It is not sure of a box that it rejected for what the pixels show, that it did not
    measure, or that is a toss-up.
    """
    if said_verdict(answer) is not None or Reason(reason) in NOTHING_TO_SEE:
        return False
    return toss_up or Reason(reason) is not Reason.VISIBLE


class ReviewState(NamedTuple):
    """Boxes by what was said of them last."""

    answers: tuple[str, ...]
    """Of such boxes; empty text where nobody said anything, or took it back."""
    condition: Callable[[], ColumnElement[bool]]
    """The same as SQL on current decisions."""
    others: str | None = None
    """The state of all other boxes, where most boxes of a dataset are in this one."""


def _undecided() -> ColumnElement[bool]:
    return or_(Decision.review.is_(None), Decision.review == "unsure")


def _contradicting() -> tuple[ColumnElement[bool], ColumnElement[bool]]:
    kept, rejected = reasons_of(Verdict.KEPT), reasons_of(Verdict.REJECTED)
    return (
        and_(Decision.review == "keep", Decision.reason.in_(rejected)),
        and_(Decision.review == "reject", Decision.reason.in_(kept)),
    )


REVIEW_STATES: Final[Mapping[str, ReviewState]] = {
    "undecided": ReviewState(("", "unsure"), _undecided, "decided"),
    "decided": ReviewState(
        ("keep", "reject"), lambda: Decision.review.in_(("keep", "reject"))
    ),
    "keep": ReviewState(("keep",), lambda: Decision.review == "keep"),
    "reject": ReviewState(("reject",), lambda: Decision.review == "reject"),
    "unsure": ReviewState(("unsure",), lambda: Decision.review == "unsure"),
    # Said so that SQLite does not take it for what its partial index holds, and that
    # PostgreSQL still knows how many they are.
    "none": ReviewState(("",), lambda: Decision.review.is_(None).is_(True), "any"),
    "any": ReviewState(
        ("keep", "reject", "unsure"), lambda: Decision.review.is_not(None)
    ),
}
"""By the words of the filter `review` of a list."""
