"""What a job is called: a run or an export, by its number."""

from __future__ import annotations

from typing import NamedTuple


class Job(NamedTuple):
    """A run or an export, by its number."""

    kind: str
    id: int
