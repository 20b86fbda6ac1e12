"""What happens to a run, as events for those who watch it.

Events are read off the run's row, so it does not matter which process carries it out.
"""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import suppress
from functools import partial
from typing import Any, Final, NamedTuple

from anyio import sleep

from app.errors import NotFound, TooManyRequests
from app.repositories.runs import RunRepository
from app.services.context import ServiceContext
from app.services.run_states import OPEN, described_run
from app.services.shared_looks import INTERVAL_S, Seen

NOTHING_SEEN: Final = -1


class RunEvent(NamedTuple):
    """How a run is; `number` grows, and is the same whoever looks."""

    name: str
    number: int
    run: dict[str, Any]


async def run_events(
    context: ServiceContext, run_id: int, after: int, token_id: int
) -> AsyncGenerator[RunEvent | None, None]:
    """Each change of a run that comes after an event, and at last its end.

    None again and again while nothing changes, so that who passes the events on can
    look after other things. A run that is deleted has no end.
    """
    read = partial(_look, context)
    # Somebody may have taken the last place since `newest` found one: ask again.
    with suppress(TooManyRequests), context.looks.watching(run_id, token_id):
        while not context.engine.stopping.is_set():
            run = await context.looks.look(run_id, read)
            if run is None:
                return
            number = progress_number(run)
            yield RunEvent("progress", number, run) if number > after else None
            if is_over(run):
                yield RunEvent("end", end_number(run), run)
                return
            after = max(after, number)
            await sleep(INTERVAL_S)


async def newest(context: ServiceContext, run_id: int, token_id: int) -> dict[str, Any]:
    """A run as it is now; NotFound."""
    with context.looks.watching(run_id, token_id):
        run = await context.looks.look(run_id, partial(_look, context))
    if run is None:
        raise NotFound("run", run_id)
    return run


def is_over(run: dict[str, Any]) -> bool:
    """True when nothing will happen to a run any more."""
    return run["state"] not in OPEN


def progress_number(run: dict[str, Any]) -> int:
    """0 while it waits, then one more than what is done, and one more when over."""
    if run["state"] == "queued":
        return 0
    return end_number(run) - 1 if is_over(run) else 1 + int(run["done"])


def end_number(run: dict[str, Any]) -> int:
    """The number of a run's last event."""
    return int(run["total"]) + 3


def _look(context: ServiceContext, run_id: int) -> Seen:
    with context.database.read() as session:
        run = RunRepository(session).find(run_id)
        return None if run is None else described_run(context, session, run)
