"""`unghost login`: a link that signs a browser in, once."""

from __future__ import annotations

import os
import threading
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Annotated

import typer

from unghost.cli.command import command
from unghost.cli.exits import Refused
from unghost.cli.login_page import LoginPage
from unghost.cli.options import ServerOptions
from unghost.client import Client
from unghost.discovery import state_folder
from unghost.people_results import NewLoginCode


@dataclass(frozen=True, kw_only=True)
class LoginOptions(ServerOptions):
    """Options of `unghost login`."""

    open: Annotated[
        bool,
        typer.Option(
            "--open", help="Open it in the browser, and wait until it was used."
        ),
    ] = False


def register(app: typer.Typer) -> None:
    """Add the command."""
    command(app, "login")(login)


def login(options: LoginOptions) -> None:
    """Print a link that signs a browser in as you: once, within ten minutes.

    Whoever opens it first is let in, so give it to nobody.
    """
    with options.connect() as client:
        made = client.create_login_code()
        link = f"{client.url}/#code={made.code}"
        if not options.open:
            options.screen.record({**made.raw, "login_link": link}, link)
            return
        _open(client, made, link, state_folder(os.environ))


def _open(client: Client, made: NewLoginCode, link: str, folder: Path) -> None:
    def is_over() -> bool:
        if made.expires_at <= datetime.now(timezone.utc):
            return True
        return client.login_code(made.id).used_at is not None

    page = LoginPage(link, folder)
    try:
        if not page.show():
            raise Refused(
                "there is no browser here to open; `unghost login` prints the link"
            )
        page.remove_when(is_over, threading.Event())
    finally:
        page.remove()
