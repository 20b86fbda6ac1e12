"""Tokens as they are asked for and answered."""

from __future__ import annotations

from typing import Annotated

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field

from app.security import Role

PRINTABLE = r"^[^\x00-\x1f\x7f-\x9f\u2028\u2029]*[^\s\x00-\x1f\x7f-\x9f]$"


class TokenIn(BaseModel):
    """A new token."""

    model_config = ConfigDict(extra="forbid")

    name: Annotated[
        str,
        Field(
            min_length=1,
            max_length=100,
            pattern=PRINTABLE,
            description="Who will show it; reviews carry this name.",
        ),
    ]
    role: Role = Role.REVIEWER
    expires_at: AwareDatetime | None = None


class TokenOut(BaseModel):
    """A token, without the token."""

    id: int
    name: str
    role: Role
    created_at: AwareDatetime
    expires_at: AwareDatetime | None
    revoked_at: AwareDatetime | None


class NewTokenOut(TokenOut):
    """The one answer that carries the token itself."""

    token: str
