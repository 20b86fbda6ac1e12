"""Tokens as they are asked for and answered."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Annotated, Final

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, model_validator

from app.security import Role

DEFAULT_DAYS: Final = 90
"""How long a token lasts for which nobody says otherwise."""
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
    expires_at: AwareDatetime | None = Field(
        default=None, description="When it ends; else `expires_in_days` says so."
    )
    expires_in_days: int | None = Field(
        default=DEFAULT_DAYS,
        ge=1,
        le=36_500,
        description="Days until it ends; null: never.",
    )

    @model_validator(mode="after")
    def _ends_once(self) -> TokenIn:
        if self.expires_at is not None and "expires_in_days" in self.model_fields_set:
            raise ValueError("expected either expires_at or expires_in_days")
        return self

    def ends(self, now: datetime) -> datetime | None:
        """When the token lets nobody in any more; None: never."""
        if self.expires_at is not None or self.expires_in_days is None:
            return self.expires_at
        return now + timedelta(days=self.expires_in_days)


class TokenOut(BaseModel):
    """A token, without the token."""

    id: int
    name: str
    role: Role
    created_at: AwareDatetime
    expires_at: AwareDatetime | None
    revoked_at: AwareDatetime | None
    last_used_at: AwareDatetime | None


class NewTokenOut(TokenOut):
    """The one answer that carries the token itself."""

    token: str
