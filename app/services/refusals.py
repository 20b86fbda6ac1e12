"""Refusals in words that name the frame, wherever in it the fault was found."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from sqlalchemy.orm import Session

from app.db.tables import Problem
from app.repositories.runs import ProblemRepository
from filter_core.errors import AnnotationErrors, FilterError, problem_of


@contextmanager
def naming(key: str = "", pointer: str = "") -> Iterator[None]:
    """Say which frame, and which part of it, a fault raised within belongs to."""
    try:
        yield
    except AnnotationErrors:
        raise  # each of them names the frame and its own place
    except FilterError as error:
        text = error.detail
        if key and not text.startswith(f"frame {key}"):
            text = f"frame {key}: {text}"
        raise type(error)(
            text, pointer=error.pointer or pointer, code=error.kind
        ) from error


def described(error: FilterError) -> dict[str, Any]:
    """A refusal as it is remembered: the fault, or each of several."""
    problem = problem_of(error)
    told = {key: value for key, value in problem.items() if key != "title"}
    return {"code": problem["code"], **told}


def note_problem(
    session: Session, dataset_id: int, key: str, error: FilterError
) -> None:
    """Remember a refusal, so that nobody has to search for a missing frame."""
    problems = ProblemRepository(session)
    problems.forget(dataset_id, key)
    problems.add(Problem(dataset_id=dataset_id, key=key, error=described(error)))
