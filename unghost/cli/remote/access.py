"""Commands for access: login links, tokens, the audit log."""

from __future__ import annotations

import json
import os
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime, timedelta, timezone
from html import escape
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from unghost.cli.options import DataFolder, OutputOptions, ServerOptions, settings_of
from unghost.cli.screen import (
    Refused,
    naming_options,
    one_line,
    partly_done,
    refused_on,
)
from unghost.wire.words import Role

if TYPE_CHECKING:
    from unghost.client.client import Client
    from unghost.wire import AuditEntry, NewToken, Token


_TOKEN_COLUMNS: Final = ("number", "name", "role", "made", "until", "used", "state")
_AUDIT_COLUMNS: Final = ("when", "who", "what", "on what", "details")
_CHECK_EVERY_S: Final = 1.0
_PAGE_PREFIX: Final = "login-"
_PAGE_SUFFIX: Final = ".html"
_PAGE: Final = """<!doctype html>
<meta charset="utf-8">
<meta name="referrer" content="no-referrer">
<meta http-equiv="refresh" content="0; url={link}">
<title>Unghost</title>
<p><a href="{link}">Open Unghost</a></p>
"""


@dataclass(frozen=True, kw_only=True)
class LoginOptions(ServerOptions):
    open: Annotated[
        bool,
        typer.Option(
            "--open",
            help="Open the link in the browser, and wait until it has been used.",
        ),
    ] = False

    def connect(self) -> Client:
        """A client of the server that is named, else of the one that runs here."""
        from unghost.client.discovery import DEFAULT_URL, SERVER_VARIABLE, noted_servers

        if self.server is None and not os.environ.get(SERVER_VARIABLE):
            running = noted_servers(os.environ)
            if len(running) == 1 and running[0] != DEFAULT_URL:
                self.screen.note(f"the server at {running[0]} (--server: another)")
                return replace(self, server=running[0]).connect()
            if running and DEFAULT_URL not in running:
                raise Refused(
                    f"several servers run on this machine: {', '.join(running)}; "
                    "--server URL selects one"
                )
        return super().connect()


def login(options: LoginOptions) -> None:
    """Print a link that signs a browser in as you: once, within ten minutes.

    The first person who opens it is signed in as you: do not give it to anybody.
    """
    from unghost.wire.note import state_folder

    with options.connect() as client:
        made = client.create_login_code()
        link = f"{client.url}/#code={made.code}"
        if not options.open:
            options.screen.record({**made.raw, "login_link": link}, link)
            return

        def is_over() -> bool:
            if made.expires_at <= datetime.now(timezone.utc):
                return True
            return client.login_code(made.id).used_at is not None

        folder = state_folder(os.environ)
        if not show_login_page(link, folder, is_over, threading.Event()):
            raise Refused(
                "no browser can be opened here; `unghost login` prints the link"
            )


@dataclass(frozen=True, kw_only=True)
class StoreTokenOptions(ServerOptions):
    with_token: Annotated[
        bool,
        typer.Option("--with-token", help="Read the token from the standard input."),
    ] = False


def store_token(options: StoreTokenOptions) -> None:
    """Store a server and a token for it, which later commands use without asking.

    The token is that of --token, of the standard input, or typed; it is checked first.
    """
    from unghost.client.discovery import StoredServers, store_servers, stored_servers

    token = options.token
    if token is None and options.with_token:
        token = sys.stdin.readline().strip()
    elif token is None and sys.stdin.isatty():
        token = typer.prompt("Token", hide_input=True, err=True)
    with replace(options, token=token).connect() as client:
        if not client.token:
            raise Refused(
                "expected a token, found none: give it as --token or, with "
                "--with-token, on the standard input"
            )
        session = client.session()
        before = stored_servers(os.environ)
        tokens = {**before.tokens, client.url: client.token}
        file = store_servers(os.environ, StoredServers(client.url, tokens))
        text = f"{client.url}: {session.name} ({session.role}), stored in {file}"
        options.screen.record({**session.raw, "server": client.url}, text)


def show_stored(options: OutputOptions) -> None:
    """Show the stored servers, and as whom their tokens work; * is the default."""
    from unghost.client.client import Client
    from unghost.client.discovery import stored_servers
    from unghost.client.errors import ApiError

    stored = stored_servers(os.environ)
    if not stored.tokens:
        raise Refused("no server is stored: `unghost auth login` stores one")
    rows, failed = [], 0
    for url, token in stored.tokens.items():
        try:
            with Client(url, token, retry_for=0) as client:
                session = client.session()
            cells: tuple[str, str, str] = (session.name, session.role, "works")
        except ApiError as error:
            cells = ("", "", one_line(error.detail))
            failed += 1
        names = ("server", "name", "role", "state")
        row = (f"{url} *" if url == stored.default else url, *cells)
        rows.append(row)
        options.screen.record(dict(zip(names, (url, *cells), strict=True)))
    options.screen.table(("server", "name", "role", "state"), rows)
    if failed:
        raise partly_done(len(rows) - failed)


@dataclass(frozen=True, kw_only=True)
class ForgetTokenOptions(OutputOptions):
    server: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Which server; default: the default one."),
    ] = None


def forget_token(options: ForgetTokenOptions) -> None:
    """Forget a stored server and its token; the token itself stays valid."""
    from unghost.client.discovery import StoredServers, store_servers, stored_servers

    stored = stored_servers(os.environ)
    url = (options.server or stored.default or "").rstrip("/")
    if url not in stored.tokens:
        servers = ", ".join(stored.tokens) or "none"
        raise Refused(f"expected a stored server ({servers}), found {url or 'none'}")
    tokens = {key: token for key, token in stored.tokens.items() if key != url}
    default = next(iter(tokens), None) if url == stored.default else stored.default
    store_servers(os.environ, StoredServers(default, tokens))
    options.screen.note(f"{url} is forgotten; `unghost token revoke` ends its token")


def show_login_page(
    link: str, folder: Path, is_over: Callable[[], bool], stop: threading.Event
) -> bool:
    """Open a login link in the browser, and wait until it is used, expired or stopped.

    Everybody on the machine can see the arguments of a browser. So the browser gets the
    name of a file that only its owner can read, and that contains the link. It is made
    in `folder`, which need not exist, and removed at the end.

    `is_over` tells whether the link was used, or its time is up; `stop` ends the wait.
    Returns False, at once, if there is no browser.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    # mkstemp makes a file with a new name that only its owner can read.
    descriptor, name = tempfile.mkstemp(_PAGE_SUFFIX, _PAGE_PREFIX, folder)
    file = Path(name)
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
            stream.write(_PAGE.format(link=escape(link)))
        if not webbrowser.open(file.resolve().as_uri()):
            return False
        while not stop.is_set() and not is_over():
            stop.wait(_CHECK_EVERY_S)
    finally:
        file.unlink(missing_ok=True)
    return True


def remove_login_pages(folder: Path) -> None:
    """Remove the files of processes that were killed."""
    for file in folder.glob(f"{_PAGE_PREFIX}*{_PAGE_SUFFIX}"):
        file.unlink(missing_ok=True)


@dataclass(frozen=True, kw_only=True)
class CreateTokenOptions(ServerOptions):
    name: Annotated[
        str,
        typer.Argument(
            help="Name of the person who will use the token; their answers are stored "
            "under it."
        ),
    ]
    role: Annotated[
        Role,
        typer.Option(
            help="What the token allows. viewer: see everything; reviewer: also "
            "answer, upload and start runs; admin: also delete and create tokens."
        ),
    ] = "reviewer"
    days: Annotated[
        int,
        typer.Option(
            min=0,
            max=36500,
            help="Days until the token expires; 0: it lasts until it is revoked.",
        ),
    ] = 0
    offline: Annotated[
        bool,
        typer.Option(
            "--offline",
            help="Write the token into the database itself, without a server: the one "
            "of UNGHOST_DATABASE_URL, else that of the data folder.",
        ),
    ] = False
    data: DataFolder = None


def create_token(options: CreateTokenOptions) -> None:
    """Create a token and print it; it is not shown again."""
    until = None
    if options.days > 0:
        until = datetime.now(timezone.utc) + timedelta(days=options.days)
    if options.offline:
        token, where = _make_token_offline(options, until), "the address of the service"
    else:
        if options.data is not None:
            raise typer.BadParameter("--data is for --offline")
        named = naming_options({"/name": "NAME"}, {"NAME": options.name})
        with options.connect() as client, named:
            token = client.create_token(options.name, options.role, expires_at=until)
            where = client.url
    options.screen.record(token.raw, token.token)
    options.screen.note(
        f"token {token.id} of {token.name!r}, {token.role}, {_until(token)}: it is "
        f"not shown again. Use it to log in at {where}, or as UNGHOST_TOKEN."
    )


def list_tokens(options: ServerOptions) -> None:
    """List the tokens: when they expire, and when they were last used."""
    with options.connect() as client:
        options.screen.listing(_TOKEN_COLUMNS, client.tokens(), _token_row)


@dataclass(frozen=True, kw_only=True)
class RevokeTokenOptions(ServerOptions):
    which: Annotated[
        str, typer.Argument(metavar="NAME", help="Name or number of the token.")
    ]


def revoke_token(options: RevokeTokenOptions) -> None:
    """Revoke a token; it and the sessions that it opened end at once."""
    with options.connect() as client:
        token = _find_token(client, options.which)
        client.revoke_token(token.id)
        left = next(stored for stored in client.tokens() if stored.id == token.id)
    options.screen.record(left.raw, "\t".join(map(str, _token_row(left))))


def _find_token(client: Client, which: str) -> Token:
    """The token of this name, else of this number, since names may be numbers."""
    tokens = list(client.tokens())
    for token in tokens:
        if token.name == which:
            return token
    for token in tokens:
        if str(token.id) == which:
            return token
    # Imported here, because it loads the library.
    from filter_core.values import similar

    close = similar(which, (token.name for token in tokens))
    hint = f"the nearest is {close!r}; " if close else ""
    raise Refused(f"there is no token {which!r}; {hint}`unghost token list` lists all")


def _token_row(token: Token) -> tuple[object, ...]:
    made, used = f"{token.created_at:%Y-%m-%d}", "never"
    if token.last_used_at is not None:
        used = f"{token.last_used_at:%Y-%m-%d %H:%M}"
    ends, now = token.expires_at, datetime.now(timezone.utc)
    state = "expired" if ends is not None and ends <= now else "valid"
    if token.revoked_at is not None:
        state = "revoked"
    return token.id, token.name, token.role, made, _until(token), used, state


def _until(token: Token) -> str:
    if token.expires_at is None:
        return "never expires"
    return f"until {token.expires_at:%Y-%m-%d %H:%M} UTC"


def _make_token_offline(
    options: CreateTokenOptions, until: datetime | None
) -> NewToken:
    """Create a token directly in the database of this data folder."""
    for name, value in (("--server", options.server), ("--token", options.token)):
        if value is not None:
            raise typer.BadParameter(f"{name} is not for --offline: no server is asked")

    from pydantic import ValidationError
    from sqlalchemy.exc import OperationalError

    from app.access.audit import AuditTrail
    from app.access.service import issue
    from app.errors import AppError
    from app.maintenance.datafolder import CannotMaintain, opened
    from unghost.wire import NewToken, Token, TokenIn

    try:
        row = TokenIn.model_validate(
            {"name": options.name, "role": options.role, "expires_at": until}
        )
    except ValidationError as exc:
        raise typer.BadParameter("a name has 1 to 100 printable characters") from exc
    settings = settings_of(data=options.data)
    try:
        with refused_on(CannotMaintain, AppError), opened(settings) as database:
            with database.write() as session:
                stored, secret = issue(
                    AuditTrail(session), row.name, row.role, row.expires_at
                )
            token = Token.model_validate(stored, from_attributes=True)
    except OperationalError as exc:
        raise Refused(
            f"the token cannot be stored: {exc.orig}; `unghost doctor` says more"
        ) from exc
    return NewToken.read({**token.model_dump(mode="json"), "token": secret})


@dataclass(frozen=True, kw_only=True)
class AuditOptions(ServerOptions):
    limit: Annotated[
        int,
        typer.Option(min=0, help="Maximum number of entries, newest first; 0 for all."),
    ] = 100


def audit(options: AuditOptions) -> None:
    """List who did what to tokens, data, configurations, jobs and bulk answers."""
    with options.connect() as client:
        entries = islice(client.audit(), options.limit or None)
        options.screen.listing(_AUDIT_COLUMNS, entries, _audit_row)


def _audit_row(entry: AuditEntry) -> tuple[object, ...]:
    when = f"{entry.created_at:%Y-%m-%d %H:%M:%S}"
    values = {key: value for key, value in entry.details.items() if value is not None}
    texts = {
        key: value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
        for key, value in values.items()
    }
    details = " ".join(f"{key}={text}" for key, text in texts.items())
    return when, entry.actor, entry.action, entry.subject, details
