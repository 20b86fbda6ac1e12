"""Jobs outlast a store that goes away for a while; requests do not wait so long."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final, TypeVar

from app.engine import Job
from app.errors import StorageAway
from app.services.context import ServiceContext

PAUSES_S: Final = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 15.0)
_LOOK_S: Final = 0.25
_T = TypeVar("_T")


def enduring(context: ServiceContext, job: Job, ask: Callable[[], _T]) -> _T:
    """What a store answers, tried for half a minute; StorageAway after that.

    Raises
    ------
    JobStopped
        The service stops, or nobody wants the job any more.
    """
    for pause_s in PAUSES_S:
        try:
            return ask()
        except StorageAway:
            _pause(context, job, pause_s)
    return ask()


def _pause(context: ServiceContext, job: Job, seconds: float) -> None:
    until = time.monotonic() + seconds
    while (left := until - time.monotonic()) > 0:
        context.engine.check(job)
        context.engine.stopping.wait(min(left, _LOOK_S))
