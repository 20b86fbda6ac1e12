"""Runs: one config applied to a whole dataset."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from unghost.calls.base import Calls, dataset_path
from unghost.errors import run_failed
from unghost.transport import API
from unghost.work_results import Run


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
        run_id = run if isinstance(run, int) else run.id
        ended = self._polled(lambda: self.run(run_id), progress, timeout_s)
        if ended.state != "done":
            raise run_failed(f"run {run_id}", ended.state, ended.error)
        return ended
