"""What a driver asks a worker's process to do: the only function that is sent."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

RemoteWork = Callable[[str, int, int, str], str]

_WORK: Final[list[RemoteWork]] = []


def work_with(work: RemoteWork) -> None:
    """Say how this process works on chunks; a worker does so before it joins."""
    _WORK[:] = [work]


def work_on(kind: str, job_id: int, number: int, installation: str) -> str:
    """Work on a chunk of a job in the database of an installation; how it ended."""
    if not _WORK:
        raise RuntimeError("this process is no worker of Unghost")
    return _WORK[0](kind, job_id, number, installation)
