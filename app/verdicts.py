"""The effective verdict of a box: a person's keep or reject, else the filter's verdict.

It is defined twice here: in Python, for one box, and in SQL, for lists. For arrays the
library defines it (`DecidedBoxes.effective`). `tests/unit/app/test_verdicts.py`
compares the three for every reason and answer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from sqlalchemy import ColumnElement, and_, case, literal, or_

from app.db.tables import Decision
from filter_core.decisions.doubt import Bin
from filter_core.verdicts import Reason, Verdict
from unghost.wire import words

_VERDICT_OF_ANSWER: Final[Mapping[str, Verdict]] = {
    "keep": Verdict.KEPT,
    "reject": Verdict.REJECTED,
}
"""The verdict by which an answer replaces the filter's; `unsure` replaces none."""


def effective_verdict(reason: int, answer: str | None) -> words.Verdict:
    """The verdict of an answer `keep` or `reject`; without one, the filter's."""
    return with_answer(Reason(reason).verdict.value, answer)


def with_answer(verdict: words.Verdict, answer: str | None) -> words.Verdict:
    """As `effective_verdict`, for the filter's verdict in place of its reason."""
    answered = verdict_of(answer)
    return verdict if answered is None else answered.value


def verdict_of(answer: str | None) -> Verdict | None:
    """The verdict of an answer; None for any but `keep` and `reject`."""
    return _VERDICT_OF_ANSWER.get(answer or "")


def is_effective(verdict: Verdict) -> ColumnElement[bool]:
    """SQL condition: the effective verdict of a current decision is this one."""
    by_filter = and_(_undecided(), Decision.reason.in_(reasons_of(verdict)))
    for answer, answered in _VERDICT_OF_ANSWER.items():
        if answered is verdict:
            return or_(Decision.review == answer, by_filter)
    return by_filter


def reasons_of(verdict: Verdict) -> tuple[int, ...]:
    """The reasons that give this verdict."""
    return tuple(int(reason) for reason in Reason if reason.verdict is verdict)


def in_conflict(reason: int, answer: str | None) -> bool:
    """Whether a person's `keep` or `reject` is the opposite of the filter's verdict.

    An answer on an unmeasured box is in conflict with nothing.
    """
    answered, verdict = verdict_of(answer), Reason(reason).verdict
    can_conflict = verdict in _VERDICT_OF_ANSWER.values() and answered is not None
    return can_conflict and answered is not verdict


def is_in_conflict() -> ColumnElement[bool]:
    """SQL condition: a person's answer is in conflict with the current decision."""
    kept, rejected = reasons_of(Verdict.KEPT), reasons_of(Verdict.REJECTED)
    # The first condition lets the index on answered boxes be used.
    return and_(
        Decision.review.in_(tuple(_VERDICT_OF_ANSWER)),
        or_(
            and_(Decision.review == "keep", Decision.reason.in_(rejected)),
            and_(Decision.review == "reject", Decision.reason.in_(kept)),
        ),
    )


def is_not_in_conflict() -> ColumnElement[bool]:
    """SQL condition: no answer is in conflict with the current decision."""
    # Not `not_`: for a box without an answer it would be NULL, and leave the box out.
    kept, rejected = reasons_of(Verdict.KEPT), reasons_of(Verdict.REJECTED)
    return or_(
        _undecided(),
        and_(Decision.review == "keep", Decision.reason.not_in(rejected)),
        and_(Decision.review == "reject", Decision.reason.not_in(kept)),
    )


BIN: Final = case(
    (Decision.doubt > Bin.ASK, literal(int(Bin.ASK))), else_=Decision.doubt
).label("bin")
"""The bin of a current decision in SQL; `filter_core.decisions.doubt` defines it."""


def in_bin(bin_: Bin) -> ColumnElement[bool]:
    """SQL condition: a current decision is in this bin."""
    if bin_ is Bin.ASK:
        return Decision.doubt > int(Bin.SURE)
    return Decision.doubt == int(bin_)


class ReviewState(NamedTuple):
    """Boxes whose latest answer is one of a few, as a filter of lists."""

    answers: tuple[str, ...]
    """Their latest answers; empty text for no answer, or one that was undone."""
    condition: Callable[[], ColumnElement[bool]]
    """The same as SQL on current decisions."""
    others: str | None = None
    """The state of all other boxes; set if most boxes of a dataset are in this one."""


def _undecided() -> ColumnElement[bool]:
    return or_(Decision.review.is_(None), Decision.review == "unsure")


REVIEW_STATES: Final[Mapping[str, ReviewState]] = {
    "undecided": ReviewState(("", "unsure"), _undecided, "decided"),
    "decided": ReviewState(
        ("keep", "reject"), lambda: Decision.review.in_(("keep", "reject"))
    ),
    "keep": ReviewState(("keep",), lambda: Decision.review == "keep"),
    "reject": ReviewState(("reject",), lambda: Decision.review == "reject"),
    "unsure": ReviewState(("unsure",), lambda: Decision.review == "unsure"),
    # Written so that SQLite does not use the index on answers and doubt, which nearly
    # all boxes fit, and PostgreSQL can still estimate the number of rows.
    "none": ReviewState(("",), lambda: Decision.review.is_(None).is_(True), "any"),
    "any": ReviewState(
        ("keep", "reject", "unsure"), lambda: Decision.review.is_not(None)
    ),
}
"""The states by which lists can be filtered, by the value of the filter `review`."""
