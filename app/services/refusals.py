"""Refusals in words that name the frame, wherever in it the fault was found."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from filter_core.errors import AnnotationErrors, FilterError


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
    faults = error.errors if isinstance(error, AnnotationErrors) else (error,)
    return {
        "code": error.kind,
        "detail": error.detail,
        "errors": [
            {"pointer": fault.pointer, "code": fault.kind, "detail": fault.detail}
            for fault in faults
        ],
    }
