"""`unghost token`: giving people tokens and taking them back. For admins."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from enum import Enum
from typing import Annotated

import typer

from unghost.cli.command import command
from unghost.cli.data_options import DataFolder
from unghost.cli.exits import Refused
from unghost.cli.offline_token import create_offline
from unghost.cli.options import ServerOptions
from unghost.client import Client
from unghost.people_results import NewToken, Token

app = typer.Typer(
    help="Give people tokens and take them back; needs a token of an admin.",
    no_args_is_help=True,
)
_COLUMNS = ("number", "name", "role", "made", "until", "used", "state")


class RoleName(str, Enum):
    """What a token may do."""

    VIEWER = "viewer"
    REVIEWER = "reviewer"
    ADMIN = "admin"


@dataclass(frozen=True, kw_only=True)
class CreateOptions(ServerOptions):
    """Options of `unghost token create`."""

    name: Annotated[
        str, typer.Argument(help="Who will show it; answers carry this name.")
    ]
    role: Annotated[
        RoleName,
        typer.Option(
            help="viewer looks, reviewer also answers, uploads and runs, admin also "
            "deletes and gives tokens."
        ),
    ] = RoleName.REVIEWER
    days: Annotated[
        int,
        typer.Option(min=0, max=36500, help="Days until it expires; 0: never."),
    ] = 90
    offline: Annotated[
        bool,
        typer.Option(
            "--offline",
            help="Write it into the database (UNGHOST_DATABASE_URL, or that of the "
            "data folder); no server is asked.",
        ),
    ] = False
    data: DataFolder = None


@command(app, "create")
def create(options: CreateOptions) -> None:
    """Make a token and print it, this once."""
    until = None
    if options.days > 0:
        until = datetime.now(timezone.utc) + timedelta(days=options.days)
    made, where = _made(options, until)
    options.screen.record(made.raw, made.token)
    options.screen.note(
        f"token {made.id} of {made.name!r}, {made.role}, {_until(made)}: nobody is "
        f"shown it again. It is pasted at {where}, or put into UNGHOST_TOKEN."
    )


def _made(options: CreateOptions, until: datetime | None) -> tuple[NewToken, str]:
    """The token, and the address at which it logs in."""
    if options.offline:
        made = create_offline(options.name, options.role.value, until, options.data)
        return made, "the address of the service"
    with options.connect() as client:
        made = client.create_token(
            options.name, options.role.value, expires_at=until, expires_in_days=None
        )
        return made, client.url


@dataclass(frozen=True, kw_only=True)
class ListOptions(ServerOptions):
    """Options of `unghost token list`."""


@command(app, "list")
def list_tokens(options: ListOptions) -> None:
    """List the tokens: until when they last, and when they were last used."""
    with options.connect() as client:
        found = list(client.tokens())
    for token in found:
        options.screen.record(token.raw)
    options.screen.table(_COLUMNS, [_row(token) for token in found])


@dataclass(frozen=True, kw_only=True)
class RevokeOptions(ServerOptions):
    """Options of `unghost token revoke`."""

    which: Annotated[
        str, typer.Argument(metavar="NAME", help="The token's name or its number.")
    ]


@command(app, "revoke")
def revoke(options: RevokeOptions) -> None:
    """Take a token back; it and the sessions that it opened end at once."""
    with options.connect() as client:
        token = _meant(client, options.which)
        client.revoke_token(token.id)
        left = next(one for one in client.tokens() if one.id == token.id)
    options.screen.record(left.raw, "\t".join(map(str, _row(left))))


def _meant(client: Client, which: str) -> Token:
    """The token of this name, else of this number: names may be numbers."""
    tokens = list(client.tokens())
    for token in tokens:
        if token.name == which:
            return token
    for token in tokens:
        if str(token.id) == which:
            return token
    raise Refused(f"there is no token {which!r}; `unghost token list` has them all")


def _row(token: Token) -> tuple[object, ...]:
    made = token.created_at
    return (
        token.id,
        token.name,
        token.role,
        "" if made is None else f"{made:%Y-%m-%d}",
        _until(token),
        "never"
        if token.last_used_at is None
        else f"{token.last_used_at:%Y-%m-%d %H:%M}",
        _state(token),
    )


def _until(token: Token) -> str:
    if token.expires_at is None:
        return "without end"
    return f"until {token.expires_at:%Y-%m-%d %H:%M} UTC"


def _state(token: Token) -> str:
    if token.revoked_at is not None:
        return "revoked"
    ended = token.expires_at is not None and (
        token.expires_at <= datetime.now(timezone.utc)
    )
    return "expired" if ended else "valid"
