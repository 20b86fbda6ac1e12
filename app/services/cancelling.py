"""Cancelling a job that may be holding what one needs to write that it is cancelled."""

from __future__ import annotations

from collections.abc import Callable

from sqlalchemy import event
from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.engine import Job
from app.jobs.queries import ChunkRepository


def interrupt_until_written(
    context: ServiceContext,
    session: Session,
    job: Job,
    restart: Callable[[ServiceContext], None],
) -> None:
    """Make a job let go, before the first statement of the session that cancels it.

    That statement waits for whoever writes, and that may be this job, here or in
    another service. Where rows can be written beside it, it finds its chunk gone.
    """
    context.engine.interrupt(job)
    if not context.database.has_one_writer:
        with context.database.write_beside() as beside:
            ChunkRepository(beside).withdraw_decision(job)
    event.listen(
        session, "after_transaction_end", lambda *_: context.engine.let_be(job)
    )
    # If it cannot be written after all, the job goes on.
    event.listen(session, "after_rollback", lambda _: restart(context))
