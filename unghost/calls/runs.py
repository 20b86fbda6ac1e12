"""Runs: one config applied to a whole dataset."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

import httpx

from unghost.calls.base import Calls, dataset_path, read
from unghost.errors import BadRequest, NotFound, Unavailable, run_failed
from unghost.event_stream import read_events
from unghost.transport import API, Call
from unghost.work_results import Diff, Flip, Run

NOTHING_MORE: Final = 204


class RunCalls(Calls):
    """Methods on runs."""

    def runs(self, dataset: str) -> Iterator[Run]:
        """The runs of a dataset, newest first."""
        return self._all(Run, dataset_path(dataset, "runs"))

    def start_run(
        self, dataset: str, config: Mapping[str, Any] | str, *, activate: bool = False
    ) -> Run:
        """Apply a config (a mapping, or the digest of a stored one)."""
        body = {"config": config, "activate": activate}
        return self._post(Run, dataset_path(dataset, "runs"), body)

    def run(self, run_id: int) -> Run:
        """One run as it is now."""
        return self._get(Run, f"{API}/runs/{run_id}")

    def cancel(self, run: Run | int) -> Run:
        """End a run that is not over, so that nothing changes; `Conflict` if it is."""
        return self._post(Run, f"{API}/runs/{_id_of(run)}/cancel")

    def diff(self, run: Run | int, against: Run | int | None = None) -> Diff:
        """Counts of boxes that a run decides otherwise than another (else than the one
        that was active before it).
        """
        params = {**_against(against), "limit": 1}
        return self._get(Diff, f"{API}/runs/{_id_of(run)}/diff", params)

    def flips(self, run: Run | int, against: Run | int | None = None) -> Iterator[Flip]:
        """The boxes that `diff` counts, nearest to a threshold first."""
        path = f"{API}/runs/{_id_of(run)}/diff"
        return self._all(Flip, path, _against(against))

    def events(self, run: Run | int) -> Iterator[Run]:
        """A run each time that it changes, until it is over.

        A stream that breaks off is taken up where it was.
        """
        path, after, silent = f"{API}/runs/{_id_of(run)}/events", "", 0
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
                        yield read(Run, json.loads(event.data), told)
            except httpx.TransportError as error:
                broken = error
            silent += 1
            if silent >= self._transport.retry.attempts:
                raise broken or httpx.RemoteProtocolError("the events have no end")
            self._transport.pause(self._transport.retry.delay_s(silent))

    def wait(
        self,
        run: Run | int,
        *,
        progress: Callable[[Run], object] | None = None,
        timeout_s: float | None = None,
    ) -> Run:
        """The run when it is done; `progress` is called with each state on the way.

        Raises
        ------
        RunFailed
            It failed or was cancelled.
        TimeoutError
            It was not finished after `timeout_s`; it goes on.
        """
        run_id = _id_of(run)
        ended = self._followed(run_id, progress) if timeout_s is None else None
        if ended is None:
            ended = self._polled(lambda: self.run(run_id), progress, timeout_s)
        if ended.state != "done":
            raise run_failed(f"run {run_id}", ended.state, ended.error)
        return ended

    def _followed(
        self, run_id: int, progress: Callable[[Run], object] | None
    ) -> Run | None:
        """The run at its end, by its events; None if they cannot be had."""
        try:
            for state in self.events(run_id):
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


def _id_of(run: Run | int) -> int:
    return run if isinstance(run, int) else run.id


def _against(run: Run | int | None) -> dict[str, int]:
    return {} if run is None else {"against": _id_of(run)}
