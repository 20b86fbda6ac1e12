"""Who may do away with answers: everybody with their own, admins with all."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from app.errors import Forbidden
from app.security import Principal, Role

_NAMED: Final = 3


def require_own(by: Principal, answers: Mapping[str, int], act: str) -> int:
    """Let through whoever does away with nobody's answers but their own, and admins.

    Parameters
    ----------
    answers : mapping of str to int
        How many answers would be lost, taken back or set aside, by reviewer.
    act : str
        What is asked for, as the message begins: ``deleting frame 'a/1'``.

    Returns
    -------
    int
        How many of the answers are other people's.

    Raises
    ------
    Forbidden
        Some are, and this is no admin.
    """
    others = {name: number for name, number in answers.items() if name != by.name}
    number = sum(others.values())
    if number and not by.role.includes(Role.ADMIN):
        raise Forbidden(
            f"{act} concerns {number} {'answer' if number == 1 else 'answers'} of "
            f"{_named(sorted(others))}: this needs the role admin, "
            f"token {by.name!r} has {by.role.value}",
            code="others_answers",
        )
    return number


def _named(names: list[str]) -> str:
    more = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")
