"""Jobs outlast a store that goes away for a while; requests do not wait so long."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final, TypeVar

from app.context import ServiceContext
from app.errors import StorageAway

PAUSES_S: Final = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 15.0)
_LOOK_S: Final = 0.25
_T = TypeVar("_T")


def enduring(
    context: ServiceContext, check: Callable[[], None], ask: Callable[[], _T]
) -> _T:
    """What a store answers, tried for half a minute; StorageAway after that.

    `check` raises whatever ends the waiting: that nobody wants the job any more.
    """
    for pause_s in PAUSES_S:
        try:
            return ask()
        except StorageAway:
            _pause(context, check, pause_s)
    return ask()


def _pause(context: ServiceContext, check: Callable[[], None], seconds: float) -> None:
    until = time.monotonic() + seconds
    while (left := until - time.monotonic()) > 0:
        check()
        context.engine.stopping.wait(min(left, _LOOK_S))
