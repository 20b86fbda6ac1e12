"""A token written into the database itself, where no service can be asked for one."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from unghost.cli.data_options import refusals
from unghost.cli.exits import Refused
from unghost.cli.serve import settings_of
from unghost.people_results import NewToken

if TYPE_CHECKING:
    from app.schemas.tokens import TokenIn


def create_offline(
    name: str, role: str, expires_at: datetime | None, data: Path | None
) -> NewToken:
    """A token in the database that a server of this data folder would have.

    Raises
    ------
    Refused
        There is no such database, or the name is taken.
    """
    from app.errors import AppError
    from app.schemas.tokens import TokenOut
    from app.services.offline_tokens import issue_offline

    wanted = _checked(name, role, expires_at)
    try:
        with refusals():
            token, secret = issue_offline(
                settings_of(data=data), wanted.name, wanted.role, wanted.expires_at
            )
    except AppError as exc:
        raise Refused(exc.detail) from exc
    shown = TokenOut.model_validate(token, from_attributes=True)
    return NewToken.read({**shown.model_dump(mode="json"), "token": secret})


def _checked(name: str, role: str, expires_at: datetime | None) -> TokenIn:
    from pydantic import ValidationError

    from app.schemas.tokens import TokenIn
    from app.security import Role

    try:
        return TokenIn(name=name, role=Role(role), expires_at=expires_at)
    except ValidationError as exc:
        raise typer.BadParameter("a name has 1 to 100 printable characters") from exc
