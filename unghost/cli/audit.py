"""`unghost audit`: who did what on the server. For admins."""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import islice
from typing import Annotated

import typer

from unghost.cli.command import command
from unghost.cli.options import ServerOptions
from unghost.people_results import AuditEntry

_COLUMNS = ("when", "who", "what", "on what", "details")


@dataclass(frozen=True, kw_only=True)
class AuditOptions(ServerOptions):
    """Options of `unghost audit`."""

    limit: Annotated[
        int, typer.Option(min=0, help="Most entries, newest first; 0: all of them.")
    ] = 100


def register(app: typer.Typer) -> None:
    """Add the command."""
    command(app, "audit")(audit)


def audit(options: AuditOptions) -> None:
    """Say who did what to tokens, data, configurations, jobs and many answers."""
    with options.connect() as client:
        entries = list(islice(client.audit(), options.limit or None))
    for entry in entries:
        options.screen.record(entry.raw)
    options.screen.table(_COLUMNS, [_row(entry) for entry in entries])


def _row(entry: AuditEntry) -> tuple[object, ...]:
    when = "" if entry.created_at is None else f"{entry.created_at:%Y-%m-%d %H:%M:%S}"
    said = {key: value for key, value in entry.details.items() if value is not None}
    details = " ".join(f"{key}={_word(value)}" for key, value in said.items())
    return when, entry.actor, entry.action, entry.subject, details


def _word(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
