"""Driving a job: its chunks are planned bit by bit, sent out, and looked after.

Chunks may be done more than once and in any order; what counts is the ledger.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

from sqlalchemy.orm import Session

from app.boxes.queries import FrameRepository
from app.context import ServiceContext
from app.db.tables import Chunk
from app.engine import EngineAway, WorkerDied
from app.engine.chunk import DONE, ELSEWHERE, FAILED, GIVEN_BACK, GIVEN_UP, UNWANTED
from app.jobs.leases import JobLease
from app.jobs.queries import DECISION, ChunkRepository, Span
from app.jobs.work import MOST_ATTEMPTS, work_here
from app.services.run_measuring import frames_left

LOOK_S: Final = 0.1
LOOK_AT_ROW_S: Final = 0.5
"""How often it is asked whether the job is still wanted while nothing else happens."""
LONGEST_PAUSE_S: Final = 8.0
QUARANTINED: Final = "quarantined"

Planner = Callable[[Session, int, int], list[Span]]
"""Up to so many spans (the third) of frames behind an id (the second)."""

log = logging.getLogger(__name__)


class ChunkFailed(Exception):
    """What a job fails with, as its chunk says."""

    def __init__(self, error: Mapping[str, Any]) -> None:
        super().__init__(error["detail"])
        self.error = dict(error)


@dataclass
class ChunkDriver:
    """Carries out the chunks of one job.

    `wanted` raises `JobStopped` if the job is not open any more; `more` plans.
    """

    context: ServiceContext
    lease: JobLease
    more: Planner
    wanted: Callable[[Session, int], object]
    _again: deque[int] = field(default_factory=deque)
    _suspects: deque[int] = field(default_factory=deque)
    _in_flight: dict[Future[str], int] = field(default_factory=dict)
    _after: int = 0
    _is_planned: bool = False
    _is_alone: bool = False
    _looked_at: float = 0.0

    def drive(self) -> None:
        """Until every chunk is done.

        Raises
        ------
        JobStopped
            The service stops, nobody wants the job any more, or another process
            drives it.
        ChunkFailed
            One cannot be done; where processes died, all others are done first.
        """
        with self.context.database.read() as session:
            ledger = ChunkRepository(session)
            self._again.extend(ledger.waiting(self.lease.job))
            # What is in quarantine is not planned once more, under another number.
            if self._again or ledger.quarantined(self.lease.job):
                self._after = ledger.last_frame(self.lease.job)
        try:
            while self._send():
                self._look()
        finally:
            self.context.engine.let_go(list(self._in_flight))
        self._check_quarantine()

    def drive_here(self, number: int) -> None:
        """One chunk, in this thread whatever the engine is; raises as `drive` does.

        It is not done where it had to be given back: look, and begin again.
        """
        self._check()
        outcome = work_here(self.context, *self.lease.job, number)
        if outcome == GIVEN_UP:
            self._check_quarantine()
        elif outcome != DONE:
            self._ended(number, outcome)

    def _send(self) -> bool:
        """Send what there is room for; False once nothing is left."""
        self._check()
        try:
            while (number := self._next()) is not None:
                self._start(number)
        except EngineAway:
            self._reconnect()
        return bool(self._in_flight or self._again or self._suspects)

    def _next(self) -> int | None:
        self._is_alone = self._is_alone and bool(self._in_flight)
        if self._suspects or self._is_alone:
            # Alone: if the process dies once more, this chunk and no other one did it.
            return None if self._in_flight else self._suspects[0]
        room = self.context.engine.window - len(self._in_flight)
        if room > 0 and not self._again and not self._is_planned:
            self._plan(room)
        return self._again[0] if room > 0 and self._again else None

    def _start(self, number: int) -> None:
        here = partial(work_here, self.context)
        engine = self.context.engine
        future = engine.start_chunk(here, self.lease.job, number)
        self._is_alone = bool(self._suspects)
        (self._suspects or self._again).popleft()
        self._in_flight[future] = number

    def _plan(self, most: int) -> None:
        with self.context.database.read() as session:
            spans = self.more(session, self._after, most)
        self._is_planned = len(spans) < most
        if not spans:
            return
        self._after = spans[-1].last_frame_id
        with self.context.database.write() as session:
            self.lease.require(session)
            self.wanted(session, self.lease.job.id)
            self._again.extend(ChunkRepository(session).plan(self.lease.job, spans))

    def _look(self) -> None:
        done, _ = wait(self._in_flight, LOOK_S, FIRST_COMPLETED)
        for future in done:
            number = self._in_flight.pop(future)
            try:
                self._ended(number, self.context.engine.outcome(future))
            except WorkerDied as died:
                self._suspect(number, died)
            except EngineAway:
                self._again.append(number)
        if not self.context.engine.is_connected():
            self._reconnect()

    def _ended(self, number: int, outcome: str) -> None:
        if outcome == FAILED:
            raise ChunkFailed(self._error_of(number))
        if outcome == ELSEWHERE:
            detail = (
                "a worker looks at another database than the service; give both the "
                "same UNGHOST_DATABASE_URL"
            )
            raise ChunkFailed({"code": "worker_elsewhere", "detail": detail})
        if outcome in (GIVEN_BACK, UNWANTED):
            # If it is the job that nobody wants, its row says so.
            self._looked_at = 0.0
            self._check()
            self._again.append(number)
            self.context.engine.stopping.wait(LOOK_S)

    def _error_of(self, number: int) -> Mapping[str, Any]:
        with self.context.database.read() as session:
            self.wanted(session, self.lease.job.id)
            chunk = ChunkRepository(session).find(self.lease.job, number)
            unknown = {
                "code": "internal",
                "detail": f"the {self.lease.job.kind} failed",
            }
            return (chunk.error if chunk else None) or unknown

    def _suspect(self, number: int, died: WorkerDied) -> None:
        log.warning("chunk %d of %s %d: %s", number, *self.lease.job, died)
        with self.context.database.write() as session:
            self.lease.require(session)
            ledger = ChunkRepository(session)
            if ledger.suspect(self.lease.job, number, MOST_ATTEMPTS):
                self._suspects.append(number)

    def _check(self) -> None:
        self.context.engine.check(self.lease.job)
        self.lease.check()
        if time.monotonic() - self._looked_at >= LOOK_AT_ROW_S:
            with self.context.database.read() as session:
                self.wanted(session, self.lease.job.id)
            self._looked_at = time.monotonic()

    def _reconnect(self) -> None:
        """Wait for the engine as long as it takes, and send again what is not done."""
        self._again.extendleft(self._in_flight.values())
        self._in_flight.clear()
        pause = LOOK_S
        while True:
            self._check()
            try:
                self.context.engine.connect()
            except EngineAway as away:
                log.warning("%s %d waits for its engine: %s", *self.lease.job, away)
                self.context.engine.stopping.wait(pause)
                pause = min(2 * pause, LONGEST_PAUSE_S)
            else:
                break
        # Workers go on without it, and note what they have done.
        with self.context.database.read() as session:
            waiting = set(ChunkRepository(session).waiting(self.lease.job))
        self._again = deque(number for number in self._again if number in waiting)

    def _check_quarantine(self) -> None:
        with self.context.database.read() as session:
            given_up = ChunkRepository(session).quarantined(self.lease.job)
            if not given_up:
                return
            if self.lease.job.kind == "export":
                what = "writing it"
            elif given_up[0].number == DECISION:
                what = "deciding its boxes"
            else:
                what = self._frames(session, given_up)
        if what:
            detail = (
                f"{what} ended the process that was at it {MOST_ATTEMPTS} times; the "
                "log of the process may say why"
            )
            raise ChunkFailed({"code": QUARANTINED, "detail": detail})

    def _frames(self, session: Session, chunks: Iterable[Chunk]) -> str:
        """What lacks its numbers, by keys; nothing if other processes made them."""
        left = [frames_left(session, self.lease.job.id, chunk) for chunk in chunks]
        ends = sorted({(ids[0], ids[-1]) for ids in left if ids})
        heads = FrameRepository(session).heads({id_ for both in ends for id_ in both})
        keys = {id_: repr(frame.key) for id_, frame in heads.items()}
        named = ", ".join(
            keys[first] if first == last else f"{keys[first]} to {keys[last]}"
            for first, last in ends
        )
        word = "frame" if named in keys.values() else "frames"
        return f"{word} {named}" if named else ""
