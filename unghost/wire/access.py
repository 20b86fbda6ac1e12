"""Tokens, sessions, login codes, the audit log, and the state of the server."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Annotated, Final

from pydantic import (
    AwareDatetime,
    ConfigDict,
    Field,
    StringConstraints,
    model_validator,
)

from unghost.wire.model import IfAbsent, Json, RequestModel, ResponseModel, optional
from unghost.wire.words import Role

PRINTABLE: Final = r"^[^\x00-\x1f\x7f-\x9f\u2028\u2029]*[^\s\x00-\x1f\x7f-\x9f]$"
Secret = Annotated[str, StringConstraints(min_length=1, max_length=200)]


class TokenIn(RequestModel):
    """A new token."""

    name: Annotated[
        str,
        Field(
            min_length=1,
            max_length=100,
            pattern=PRINTABLE,
            description="Name of the person who will use the token; answers are stored "
            "under it.",
        ),
    ]
    role: Role = "reviewer"
    expires_at: AwareDatetime | None = optional(
        description="When the token expires; instead of `expires_in_days`."
    )
    expires_in_days: int | None = optional(
        ge=1,
        le=36_500,
        description="Days until the token expires; null: it lasts until it is revoked.",
    )

    @model_validator(mode="after")
    def _check_expiry(self) -> TokenIn:
        if self.expires_at is not None and "expires_in_days" in self.model_fields_set:
            raise ValueError("expected either expires_at or expires_in_days")
        return self

    def ends(self, now: datetime) -> datetime | None:
        """When the token expires; None: never."""
        if self.expires_at is not None or self.expires_in_days is None:
            return self.expires_at
        return now + timedelta(days=self.expires_in_days)


class Token(ResponseModel):
    """Someone's token, without its secret."""

    id: int
    name: str
    role: Role
    created_at: AwareDatetime
    expires_at: AwareDatetime | None
    revoked_at: AwareDatetime | None
    last_used_at: AwareDatetime | None


class NewToken(Token):
    """A token that was just created, with its secret (`token`), shown only here."""

    token: str = Field(repr=False)


class LogIn(RequestModel):
    """The credentials of a login: a token, or the code of a login link."""

    model_config = ConfigDict(hide_input_in_errors=True)

    token: Secret | None = None
    code: Secret | None = None

    @model_validator(mode="after")
    def _require_one_credential(self) -> LogIn:
        if (self.token is None) == (self.code is None):
            raise ValueError("expected either token or code")
        return self


class Session(ResponseModel):
    """The user who is signed in; answers on boxes are stored under this name."""

    name: str
    role: Role
    expires_at: AwareDatetime | None


class NewSession(Session):
    """A session that was just opened, with its secret (`session`), shown only here."""

    session: str = Field(repr=False)


class LoginCode(ResponseModel):
    """A login link that opens one session, without its code."""

    id: int
    expires_at: AwareDatetime
    used_at: AwareDatetime | None


class NewLoginCode(LoginCode):
    """A login link that was just created, with its code, shown only here."""

    code: str = Field(repr=False)


class AuditEntry(ResponseModel):
    """Who did what, when, and to what; `token_id` is null for the service itself."""

    id: int
    created_at: AwareDatetime
    actor: str = Field(
        description="Name of the token; `unghost` for the service itself."
    )
    token_id: int | None
    action: str = Field(description="What was done, such as `dataset.deleted`.")
    subject: str = Field(description="Name or number of what it was done to.")
    details: Annotated[Json, IfAbsent({})]


class Alive(ResponseModel):
    """The process answers."""

    status: Annotated[str, IfAbsent("ok")]


class Ready(ResponseModel):
    """Whether the service is ready, and the result of each check."""

    ready: bool
    checks: Annotated[Mapping[str, str], IfAbsent({})]


class Version(ResponseModel):
    """The name and the version of the program."""

    version: str
    api: Annotated[str, IfAbsent("")]
    python: Annotated[str, IfAbsent("")]
