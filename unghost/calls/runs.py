"""Runs: one config applied to a whole dataset."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from unghost.calls.base import dataset_path
from unghost.calls.followed import FollowedCalls
from unghost.errors import run_failed
from unghost.retry import PATIENCE
from unghost.transport import API
from unghost.work_results import Diff, Flip, Run


class RunCalls(FollowedCalls):
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
        return self._events(Run, f"{API}/runs/{_id_of(run)}/events")

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
        ended = self._ended(
            lambda: self.events(run_id),
            lambda: self._get(Run, f"{API}/runs/{run_id}", patience=PATIENCE),
            progress,
            timeout_s,
        )
        if ended.state != "done":
            raise run_failed(f"run {run_id}", ended.state, ended.error)
        return ended


def _id_of(run: Run | int) -> int:
    return run if isinstance(run, int) else run.id


def _against(run: Run | int | None) -> dict[str, int]:
    return {} if run is None else {"against": _id_of(run)}
