"""Attempts at chunks by the process that drives their job: who would note its end?

The next process, if this one has written down what it was about to do. That it lives is
seen by what it stores; only processes that stored nothing of a chunk count against it.
"""

from __future__ import annotations

import logging
from typing import Final

from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from app.db.engine import once_committed
from app.db.tables import Chunk
from app.db.transient import in_a_line, is_transient
from app.engine import Job
from app.repositories.ledger import LedgerRepository
from app.services.context import ServiceContext
from app.services.run_measuring import frames_left

MOST_ATTEMPTS: Final = 3
"""Processes in a row that may end at a chunk before nobody tries it again."""
_PAUSE_S: Final = 0.5

log = logging.getLogger(__name__)


class Attempt:
    """One attempt of this process at a chunk, from its row to its end."""

    def __init__(self, context: ServiceContext, job: Job, number: int) -> None:
        self._context, self._job, self._number = context, job, number
        self._is_noted = False

    def begin(self) -> bool:
        """Write it down; False if there were too many.

        Raises
        ------
        JobStopped
            The service stops, or nobody wants the job any more.
        """
        self._context.engine.check(self._job)
        self._is_noted = True  # also if the answer to the commit is lost
        with self._context.database.write() as session:
            ledger = LedgerRepository(session)
            chunk = ledger.find(self._job, self._number)
            if chunk is None or chunk.state == "done":
                return True
            if chunk.attempts >= MOST_ATTEMPTS:
                log.warning(
                    "chunk %d of %s %d ended its process %d times",
                    *(self._number, *self._job, chunk.attempts),
                )
                _give_up(session, self._job, chunk)
            if chunk.state == "quarantined":
                return False
            ledger.attempt(chunk)
        return True

    def forget(self, session: Session) -> None:
        """Something of the chunk is stored: what ends the process now is not this."""
        if self._is_noted:
            LedgerRepository(session).forget_attempts(self._job, self._number)
            once_committed(session, self._forgotten)

    def end(self) -> None:
        """The work ended, and the process did not.

        Whoever tries again in this process must not count twice: a database that is
        away is waited for, until the service stops.
        """
        while self._is_noted:
            try:
                with self._context.database.write() as session:
                    self.forget(session)
            except SQLAlchemyError as exc:
                stops = self._context.engine.stopping.wait(_PAUSE_S)
                if stops or not is_transient(exc):
                    told = self._number, *self._job, in_a_line(exc)
                    log.warning("an attempt at chunk %d of %s %d stays: %s", *told)
                    return

    def _forgotten(self) -> None:
        self._is_noted = False


def _give_up(session: Session, job: Job, chunk: Chunk) -> None:
    """Put what kills into quarantine: one frame, unless its neighbour is there too.

    Where pictures kill that stand side by side, the rest of the chunk goes with them:
    each of them alone would cost as many processes again.
    """
    ledger = LedgerRepository(session)
    left = frames_left(session, job.id, chunk) if job.kind == "run" else []
    beside = {one.last_frame_id + 1 for one in ledger.quarantined(job)}
    if len(left) < 2 or left[0] in beside:
        ledger.give_up(chunk)
    else:
        ledger.set_aside(chunk, left[0], len(left))
