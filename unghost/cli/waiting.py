"""Waiting for the server's work with a bar, and what an interruption means for it."""

from __future__ import annotations

import httpx

from unghost.cli.screen import Screen
from unghost.client import Client
from unghost.errors import ApiError, Conflict, Unavailable
from unghost.work_results import Export, Run


def wait_for_run(
    client: Client, run: Run, screen: Screen, *, cancel: bool = False
) -> Run:
    """The run when it is done; RunFailed if it did not succeed.

    Interrupted, the run goes on and that is said; or it is ended, with `cancel`.
    """
    try:
        with screen.progress(f"run {run.id}", "frames") as advance:
            return client.wait(
                run, progress=lambda state: advance(state.done, state.total)
            )
    except KeyboardInterrupt:
        said = _cancelled(client, run) if cancel else _goes_on(run)
        raise KeyboardInterrupt(said) from None
    except (httpx.TransportError, Unavailable):
        screen.note(
            f"run {run.id} goes on with the server: `unghost wait {run.id}` follows it"
        )
        raise


def wait_for_export(client: Client, export: Export, screen: Screen) -> Export:
    """The export when its file is ready; RunFailed if it did not succeed.

    Interrupted, it is ended: nobody else asked for it.
    """
    try:
        with screen.progress(f"export {export.id}", "frames") as advance:
            return client.wait_for_export(
                export, progress=lambda state: advance(state.done, state.total)
            )
    except KeyboardInterrupt:
        raise KeyboardInterrupt(_ended(client, export)) from None


def run_line(run: Run) -> str:
    """A run in one line for people."""
    parts = [f"run {run.id}", run.state]
    if run.state == "done" and run.changed is not None:
        parts.append(f"{run.changed} verdicts changed")
    if run.state == "done" and run.counts is not None:
        parts.append(f"{run.counts.kept} kept, {run.counts.rejected} rejected")
    return "\t".join(parts)


def _goes_on(run: Run) -> str:
    return (
        f"interrupted; run {run.id} goes on at the server: `unghost wait {run.id}` "
        f"follows it, `unghost cancel {run.id}` ends it"
    )


def _ended(client: Client, export: Export) -> str:
    said, anew = f"interrupted; export {export.id}", "the same command makes it anew"
    try:
        client.cancel_export(export)
    except Conflict:  # it was faster
        return f"{said} was over already, and {anew}"
    except (ApiError, httpx.TransportError):
        return f"{said} goes on at the server, and {anew}"
    return f"{said} was cancelled; {anew}"


def _cancelled(client: Client, run: Run) -> str:
    try:
        client.cancel(run)
    except Conflict:  # it was faster
        return f"interrupted; run {run.id} was over already"
    return f"interrupted; run {run.id} was cancelled, and nothing has changed"
