"""A fair lock for transactions that write, with priority for those of people.

Transactions of people are served in order of arrival, and so are all others.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import Final

from sqlalchemy import Connection, Engine, event
from sqlalchemy.exc import TimeoutError as WaitedTooLong
from sqlalchemy.pool import ConnectionPoolEntry

PEOPLE_IN_A_ROW: Final = 1
"""After this many transactions of people in a row, another one gets its turn.

A person then waits for one upload at most. More would let uploads wait for seconds."""
LONGEST_WAIT_S: Final = 30.0
_HELD: Final = "turn"


class Turns:
    """The turn to write: a lock that one transaction of a process holds at a time.

    SQLite's own lock is not fair: a waiting transaction polls for it, less and less
    often, so that some wait for seconds while others get it again and again. Here a
    transaction that ends hands the turn to the one that has waited longest: first to
    transactions that a person waits for, then to others, such as uploads and runs.
    """

    def __init__(self) -> None:
        self._changing = threading.Lock()
        self._is_taken = False
        self._people: deque[threading.Event] = deque()
        self._work: deque[threading.Event] = deque()
        self._in_a_row = 0

    def apply_to(self, engine: Engine) -> None:
        """Make transactions of this engine that have the option ``writes`` take turns.

        Those with the option ``person`` as well come first. ``turn_wait_s`` is the
        timeout in seconds. A turn ends when the connection goes back to the pool: after
        a commit or a rollback, or when the connection is lost.
        """
        event.listen(engine, "begin", self._begin)
        event.listen(engine, "checkin", self._end)

    def _begin(self, connection: Connection) -> None:
        # Noted on the database connection, until that is closed.
        kept = connection.connection.record_info
        options, notes = (
            connection.get_execution_options(),
            {} if kept is None else kept,
        )
        if options.get("writes", False) and _HELD not in notes:
            wait_s = options.get("turn_wait_s", LONGEST_WAIT_S)
            self.take(person=options.get("person", False), wait_s=wait_s)
            notes[_HELD] = True

    def _end(self, _connection: object, record: ConnectionPoolEntry) -> None:
        if (record.record_info or {}).pop(_HELD, False):
            self.give_back()

    @property
    def waiting(self) -> int:
        """How many transactions wait for their turn."""
        with self._changing:
            return len(self._people) + len(self._work)

    def take(self, *, person: bool, wait_s: float) -> None:
        """Wait until it is this thread's turn; `give_back` ends the turn.

        Raises sqlalchemy.exc.TimeoutError if it was not within `wait_s` seconds.
        """
        turn = threading.Event()
        waiting = self._people if person else self._work
        with self._changing:
            if not self._is_taken:
                self._is_taken = True
                return
            waiting.append(turn)
        if turn.wait(wait_s):
            return
        with self._changing:
            if turn.is_set():  # handed over at the last moment
                return
            waiting.remove(turn)
        raise WaitedTooLong(f"others have been writing for {wait_s:g} seconds")

    def give_back(self) -> None:
        """End the turn and hand it to the next waiting thread."""
        with self._changing:
            following: threading.Event | None = None
            of_work = self._in_a_row >= PEOPLE_IN_A_ROW or not self._people
            if self._people and not (self._work and of_work):
                self._in_a_row += 1
                following = self._people.popleft()
            else:
                self._in_a_row = 0
                if self._work:
                    following = self._work.popleft()
            self._is_taken = following is not None
            if following is not None:
                following.set()
