"""Logging the page in and out: one-time codes of login links, sessions."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Annotated, Any, Final

from fastapi import APIRouter, Request, Response
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, StringConstraints, model_validator

from app.db.access_tables import LoginCode
from app.deps import (
    AppServices,
    Audited,
    CurrentPrincipal,
    ReadSession,
    RowId,
    WriteSession,
    counting_wrong,
    make_room,
)
from app.errors import Forbidden
from app.routing import ApiRouter, OpenRouter
from app.security import Principal, Role, comes_from_no_other_page
from app.services import access
from app.services.audit import AuditTrail
from app.services.timestamps import rfc3339

PREFIX: Final = "/api/v1"
# Neither a cache nor the answer kept for an Idempotency-Key may hold a secret.
NO_STORE: Final = {"Cache-Control": "no-store"}

Secret = Annotated[str, StringConstraints(min_length=1, max_length=200)]


class LogIn(BaseModel):
    """What lets somebody in: a token, or the code of a login link."""

    model_config = ConfigDict(extra="forbid", hide_input_in_errors=True)

    token: Secret | None = None
    code: Secret | None = None

    @model_validator(mode="after")
    def _is_one(self) -> LogIn:
        if (self.token is None) == (self.code is None):
            raise ValueError("expected either token or code")
        return self


class SessionOut(BaseModel):
    """Who is asking; the name is the reviewer of the answers given."""

    name: str
    role: Role
    expires_at: datetime | None


class NewSessionOut(SessionOut):
    """The one answer that carries the session's secret."""

    session: str


class LoginCodeOut(BaseModel):
    """A login code, without the code."""

    id: int
    expires_at: datetime
    used_at: datetime | None


class NewLoginCodeOut(LoginCodeOut):
    """The one answer that carries the code itself."""

    code: str


entrance = OpenRouter(prefix=PREFIX, tag="session")
inside = ApiRouter(prefix=PREFIX, tag="session", write=Role.VIEWER)


@entrance.post("/session", status_code=201, response_model=NewSessionOut)
def log_in(
    body: LogIn,
    request: Request,
    reading: ReadSession,
    writing: WriteSession,
    services: AppServices,
) -> Response:
    """Trade a token, or the code of a login link, for a session of the page.

    The session's secret is in this answer alone; it is shown as a token is.
    """
    if not comes_from_no_other_page(request.headers):
        raise Forbidden("only the service's own page may log in")
    secret, code_id = body.token or body.code or "", None
    # Looked up without a place among the writers: guessing must not keep others out.
    with counting_wrong(request):
        if body.code is None:
            principal = access.by_token(reading, secret)
        else:
            principal, code_id = access.by_code(reading, secret)
    if code_id is not None:
        access.use_code(writing, code_id)
    by = "token" if code_id is None else "code"
    lifetime = timedelta(hours=services.settings.session_hours)
    opened = access.log_in(AuditTrail(writing, principal), by, lifetime)
    found = access.by_session(writing, opened)
    services.last_uses.note(principal.token_id)
    return JSONResponse(
        {**_described(writing, found), "session": opened},
        status_code=201,
        headers=NO_STORE,
    )


@inside.get("/session", response_model=SessionOut)
def get_session(session: ReadSession, principal: CurrentPrincipal) -> dict[str, Any]:
    """Who is asking, and until when: by a token or by a session of the page."""
    return _described(session, principal)


@inside.delete("/session", status_code=204)
def log_out(
    session: WriteSession, services: AppServices, principal: CurrentPrincipal
) -> Response:
    """End the session that is shown; a token stays as it is."""
    access.log_out(session, principal)
    if principal.session_hash is not None:
        make_room(services, session)
    services.callers.forget_on_commit(session)
    return Response(status_code=204)


@inside.post("/login-codes", status_code=201, response_model=NewLoginCodeOut)
def create_login_code(audit: Audited) -> Response:
    """A code that logs a page in as whoever asks: once, within ten minutes.

    The login link is the service's address followed by `/#code=` and the code.
    """
    code, secret = access.make_code(audit)
    return JSONResponse(
        {**_described_code(code), "code": secret}, status_code=201, headers=NO_STORE
    )


@inside.get("/login-codes/{code_id}", response_model=LoginCodeOut)
def get_login_code(
    code_id: RowId, session: ReadSession, principal: CurrentPrincipal
) -> dict[str, Any]:
    """Whether a login code of one's own was used."""
    return _described_code(access.own_code(session, principal, code_id))


def _described(session: ReadSession, principal: Principal) -> dict[str, Any]:
    ends = access.expiry(session, principal)
    return {
        "name": principal.name,
        "role": principal.role.value,
        "expires_at": None if ends is None else rfc3339(ends),
    }


def _described_code(code: LoginCode) -> dict[str, Any]:
    return {
        "id": code.id,
        "expires_at": rfc3339(code.expires_at),
        "used_at": None if code.used_at is None else rfc3339(code.used_at),
    }


router = APIRouter(redirect_slashes=False)
router.include_router(entrance)
router.include_router(inside)
