"""What happens to a job, as events for those who watch it.

Events are read off the job's row, so it does not matter which process carries it out,
nor which one is asked.
"""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import suppress
from functools import partial
from typing import Final, NamedTuple

from anyio import sleep

from app.context import ServiceContext
from app.engine import Job
from app.errors import NotFound, TooManyRequests
from app.jobs.kind import kind_of
from app.jobs.poller import INTERVAL_S, Described
from app.jobs.queries import find_job

NOTHING_SEEN: Final = -1


class JobEvent(NamedTuple):
    """How a job is; `number` grows, and is the same whoever looks."""

    name: str
    number: int
    state: Described


async def job_events(
    context: ServiceContext, job: Job, after: int, token_id: int
) -> AsyncGenerator[JobEvent | None, None]:
    """Each change of a job that comes after an event, and at last its end.

    None again and again while nothing changes, so that who passes the events on can
    look after other things. A job that is deleted has no end.
    """
    read = partial(_read, context)
    # Somebody may have taken the last place since `newest` found one: ask again.
    with suppress(TooManyRequests), context.poller.watching(job, token_id):
        while not context.engine.stopping.is_set():
            state = await context.poller.newest(job, read)
            if state is None:
                return
            number = progress_number(state)
            yield JobEvent("progress", number, state) if number > after else None
            if state.finished:
                yield JobEvent("end", end_number(state), state)
                return
            after = max(after, number)
            await sleep(INTERVAL_S)


async def newest(context: ServiceContext, job: Job, token_id: int) -> Described:
    """A job as it is now; NotFound."""
    with context.poller.watching(job, token_id):
        state = await context.poller.newest(job, partial(_read, context))
    if state is None:
        raise NotFound(*job)
    return state


def progress_number(state: Described) -> int:
    """0 while it waits, then one more than what is done, and one more when over."""
    if state.state == "queued":
        return 0
    return end_number(state) - 1 if state.finished else 1 + state.done


def end_number(state: Described) -> int:
    """The number of a job's last event."""
    return state.total + 3


def _read(context: ServiceContext, job: Job) -> Described | None:
    kind = kind_of(job)
    with context.database.read() as session:
        row = find_job(session, kind.table, job.id)
        return None if row is None else kind.describe(context, session, row)
