"""Work of the server that is followed: by its events, else by asking again."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Final

import httpx

from unghost.calls.base import Calls, WorkT, read
from unghost.errors import BadRequest, NotFound, Unavailable
from unghost.event_stream import read_events
from unghost.reading import ResultT
from unghost.transport import Call

NOTHING_MORE: Final = 204


class FollowedCalls(Calls):
    """Base of the methods on runs and exports."""

    def _events(self, kind: type[ResultT], path: str) -> Iterator[ResultT]:
        """What it is like each time that it changes, until it is over.

        A stream that breaks off is taken up where it was.
        """
        after, silent = "", 0
        while True:
            call = Call("GET", path, headers=_stream_headers(after))
            broken: httpx.TransportError | None = None
            try:
                with self._transport.stream(call) as told:
                    if told.status_code == NOTHING_MORE:
                        return
                    for event in read_events(told.iter_lines()):
                        if event.name == "end":
                            return
                        after, silent = event.id, 0
                        yield read(kind, json.loads(event.data), told)
            except httpx.TransportError as error:
                broken = error
            silent += 1
            if silent >= self._transport.retry.attempts:
                raise broken or httpx.RemoteProtocolError("the events have no end")
            self._transport.pause(self._transport.retry.delay_s(silent))

    def _ended(
        self,
        events: Callable[[], Iterator[WorkT]],
        fetch: Callable[[], WorkT],
        progress: Callable[[WorkT], object] | None,
        timeout_s: float | None,
    ) -> WorkT:
        """What it is like at its end, however it ended; TimeoutError."""
        ended = _followed(events, progress) if timeout_s is None else None
        return ended or self._polled(fetch, progress, timeout_s)


def _followed(
    events: Callable[[], Iterator[WorkT]], progress: Callable[[WorkT], object] | None
) -> WorkT | None:
    """At its end, by its events; None if they cannot be had."""
    try:
        for state in events():
            if progress is not None:
                progress(state)
            if state.finished:
                return state
    except (BadRequest, NotFound, Unavailable, httpx.TransportError):
        # No such stream, none to spare, or a proxy between: asking still works.
        return None
    return None


def _stream_headers(after: str) -> dict[str, str]:
    headers = {"Accept": "text/event-stream"}
    return {**headers, "Last-Event-ID": after} if after else headers
