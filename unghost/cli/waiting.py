"""Waiting for the server's work with a bar."""

from __future__ import annotations

from unghost.cli.screen import Screen
from unghost.client import Client
from unghost.work_results import Run


def wait_for_run(client: Client, run: Run, screen: Screen) -> Run:
    """The run when it is done; RunFailed if it did not succeed."""
    with screen.progress(f"run {run.id}", "frames") as advance:
        return client.wait(run, progress=lambda state: advance(state.done, state.total))


def run_line(run: Run) -> str:
    """A run in one line for people."""
    parts = [f"run {run.id}", run.state]
    if run.changed is not None:
        parts.append(f"{run.changed} verdicts changed")
    if run.counts is not None:
        parts.append(f"{run.counts.kept} kept, {run.counts.rejected} rejected")
    return "\t".join(parts)
