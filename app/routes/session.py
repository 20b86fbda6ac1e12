"""Logging the page in and out."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Annotated, Any, Final

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, StringConstraints

from app.deps import (
    AppServices,
    AppSettings,
    CurrentPrincipal,
    ReadSession,
    WriteSession,
    unless_guessing,
)
from app.errors import Forbidden
from app.routing import ApiRouter, OpenRouter
from app.security import SESSION_COOKIE, Role, comes_from_no_other_page
from app.services import access

PREFIX: Final = "/api/v1"


class LogIn(BaseModel):
    """A token, as in the login link."""

    model_config = ConfigDict(extra="forbid", hide_input_in_errors=True)

    token: Annotated[str, StringConstraints(min_length=1, max_length=200)]


class SessionOut(BaseModel):
    """Who is asking; the name is the reviewer of the answers given."""

    name: str
    role: Role
    expires_at: datetime | None


entrance = OpenRouter(prefix=PREFIX, tag="session")
inside = ApiRouter(prefix=PREFIX, tag="session", write=Role.VIEWER)


@entrance.post("/session", status_code=204)
def log_in(
    body: LogIn,
    request: Request,
    reading: ReadSession,
    writing: WriteSession,
    settings: AppSettings,
) -> Response:
    """Trade a token for the page's session cookie."""
    if not comes_from_no_other_page(request.headers):
        raise Forbidden("only the service's own page may log in")
    # Guessing tokens must not keep others from writing.
    with unless_guessing(request, body.token):
        principal = access.by_token(reading, body.token)
    lifetime = timedelta(hours=settings.session_hours)
    response = Response(status_code=204)
    response.set_cookie(
        SESSION_COOKIE,
        access.log_in(writing, principal, lifetime),
        max_age=int(lifetime.total_seconds()),
        httponly=True,
        samesite="strict",
        secure=request.url.scheme == "https",
    )
    return response


@inside.get("/session", response_model=SessionOut)
def get_session(session: ReadSession, principal: CurrentPrincipal) -> dict[str, Any]:
    """Who is asking, and until when: by token or by the page's cookie."""
    return {
        "name": principal.name,
        "role": principal.role,
        "expires_at": access.expiry(session, principal),
    }


@inside.delete("/session", status_code=204)
def log_out(
    session: WriteSession, services: AppServices, principal: CurrentPrincipal
) -> Response:
    """End this browser's session."""
    access.log_out(session, principal)
    services.callers.forget_on_commit(session)
    response = Response(status_code=204)
    response.delete_cookie(SESSION_COOKIE, httponly=True, samesite="strict")
    return response


router = APIRouter(redirect_slashes=False)
router.include_router(entrance)
router.include_router(inside)
