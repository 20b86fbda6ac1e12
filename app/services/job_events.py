"""What happens to a run or an export, as events for those who watch it.

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
from app.measuring.queries import DatasetRepository
from app.repositories.runs import ExportRepository, RunRepository
from app.services.exports import describe_export
from app.services.run_states import described_run
from app.services.shared_looks import INTERVAL_S, Seen
from unghost.wire.runs import Export, Run

NOTHING_SEEN: Final = -1


class JobEvent(NamedTuple):
    """How a job is; `number` grows, and is the same whoever looks."""

    name: str
    number: int
    state: Run | Export


async def job_events(
    context: ServiceContext, job: Job, after: int, token_id: int
) -> AsyncGenerator[JobEvent | None, None]:
    """Each change of a job that comes after an event, and at last its end.

    None again and again while nothing changes, so that who passes the events on can
    look after other things. A job that is deleted has no end.
    """
    read = partial(_look, context)
    # Somebody may have taken the last place since `newest` found one: ask again.
    with suppress(TooManyRequests), context.looks.watching(job, token_id):
        while not context.engine.stopping.is_set():
            state = await context.looks.look(job, read)
            if state is None:
                return
            number = progress_number(state)
            yield JobEvent("progress", number, state) if number > after else None
            if is_over(state):
                yield JobEvent("end", end_number(state), state)
                return
            after = max(after, number)
            await sleep(INTERVAL_S)


async def newest(context: ServiceContext, job: Job, token_id: int) -> Run | Export:
    """A job as it is now; NotFound."""
    with context.looks.watching(job, token_id):
        state = await context.looks.look(job, partial(_look, context))
    if state is None:
        raise NotFound(*job)
    return state


def is_over(state: Run | Export) -> bool:
    """True when nothing will happen to a job any more."""
    return state.finished


def progress_number(state: Run | Export) -> int:
    """0 while it waits, then one more than what is done, and one more when over."""
    if state.state == "queued":
        return 0
    return end_number(state) - 1 if is_over(state) else 1 + state.done


def end_number(state: Run | Export) -> int:
    """The number of a job's last event."""
    return state.total + 3


def _look(context: ServiceContext, job: Job) -> Seen:
    with context.database.read() as session:
        if job.kind == "run":
            run = RunRepository(session).find(job.id)
            return None if run is None else described_run(context, session, run)
        export = ExportRepository(session).find(job.id)
        if export is None:
            return None
        dataset = DatasetRepository(session).with_id(export.dataset_id)
        return describe_export(export, dataset.name)
