"""Routes of tokens, of logging in and out, and of the audit log."""

from __future__ import annotations

from datetime import timedelta
from functools import partial

from fastapi import Request, Response

from app.access import service as access
from app.access.audit import AuditTrail
from app.access.gate import Audited, LastUses, RecentCallers, counting_wrong_secrets
from app.access.queries import AuditRepository, Tokens
from app.db.base import utc_now
from app.db.pages import id_of_cursor
from app.errors import Forbidden
from app.http.deps import Admin, AppServices, ReadSession, RowId, Viewer, make_room
from app.http.pages import NO_STORE, Cursor, Limit, Newest, json_response, page_response
from app.http.routing import ApiRouter, OpenRouter
from app.http.transaction import WriteSession
from app.security import Principal, comes_from_no_other_page
from unghost.wire import access as wire
from unghost.wire.model import Page

audit_router = ApiRouter(prefix="/api/v1", tag="audit")


@audit_router.get("/audit", response_model=Page[wire.AuditEntry])
def list_audit(caller: Admin, query: Newest, session: ReadSession) -> Response:
    """The audit log: who changed tokens, data, configurations, jobs or many answers."""
    entries = AuditRepository(session).page(query)
    describe = partial(wire.AuditEntry.model_validate, from_attributes=True)
    return query.response(entries, describe)


login_router = OpenRouter(prefix="/api/v1", tag="session")
session_router = ApiRouter(prefix="/api/v1", tag="session")


@login_router.post("/session", status_code=201, response_model=wire.NewSession)
def log_in(
    body: wire.LogIn,
    request: Request,
    reading: ReadSession,
    writing: WriteSession,
    services: AppServices,
) -> Response:
    """Open a session of the page with a token or the code of a login link.

    Only this response contains the session's secret; send it as you would a token.
    """
    if not comes_from_no_other_page(request.headers):
        raise Forbidden("only the service's own page may log in")
    secret, code_id = body.token or body.code or "", None
    # Checked before waiting for the turn to write: guesses must not delay writers.
    with counting_wrong_secrets(request):
        if body.code is None:
            principal = access.by_token(reading, secret)
        else:
            principal, code_id = access.by_code(reading, secret)
    if code_id is not None:
        access.use_code(writing, code_id)
    by = "token" if code_id is None else "code"
    lifetime = timedelta(hours=services.settings.session_hours)
    opened = access.log_in(AuditTrail(writing, principal), by, lifetime)
    caller = access.by_session(writing, opened)
    services.one(LastUses).note(principal.token_id)
    shown = wire.NewSession(**dict(_session(writing, caller)), session=opened)
    return json_response(shown, 201, NO_STORE)


@session_router.get("/session")
def get_session(caller: Viewer, session: ReadSession) -> wire.Session:
    """The caller's name and role, and when the token or the session expires."""
    return _session(session, caller)


@session_router.delete("/session", status_code=204)
def log_out(caller: Viewer, session: WriteSession, services: AppServices) -> Response:
    """End the session that the request is sent with; a token stays valid."""
    if caller.session_hash is not None:
        Tokens(session).end_session(caller.session_hash)
        make_room(services, session)
    services.one(RecentCallers).forget_on_commit(session)
    return Response(status_code=204)


@session_router.post("/login-codes", status_code=201, response_model=wire.NewLoginCode)
def create_login_code(caller: Viewer, audit: Audited) -> Response:
    """Create a code that logs a page in as the caller: once, within ten minutes.

    The login link is the service's address followed by `/#code=` and the code.
    """
    row, secret = access.make_code(audit)
    code = wire.LoginCode.model_validate(row, from_attributes=True)
    return json_response(wire.NewLoginCode(**dict(code), code=secret), 201, NO_STORE)


@session_router.get("/login-codes/{code_id}")
def get_login_code(
    caller: Viewer, code_id: RowId, session: ReadSession
) -> wire.LoginCode:
    """One of the caller's login codes: when it expires, and whether it was used."""
    code = access.own_code(session, caller, code_id)
    return wire.LoginCode.model_validate(code, from_attributes=True)


def _session(session: ReadSession, principal: Principal) -> wire.Session:
    return wire.Session(
        name=principal.name,
        role=principal.role,
        expires_at=Tokens(session).expiry(principal),
    )


tokens_router = ApiRouter(prefix="/api/v1", tag="tokens")


@tokens_router.get("/tokens", response_model=Page[wire.Token])
def list_tokens(
    caller: Admin,
    request: Request,
    session: ReadSession,
    limit: Limit = 100,
    cursor: Cursor = None,
) -> Response:
    """All tokens, revoked ones included, oldest first; without their secrets.

    `last_used_at` is written once a minute.
    """
    after_id = 0 if cursor is None else id_of_cursor(cursor)
    rows = Tokens(session).page(after_id=after_id, limit=limit + 1)
    following = str(rows[limit - 1].id) if len(rows) > limit else None
    items = [
        wire.Token.model_validate(row, from_attributes=True) for row in rows[:limit]
    ]
    return page_response(request, items, following)


@tokens_router.post("/tokens", status_code=201, response_model=wire.NewToken)
def create_token(caller: Admin, body: wire.TokenIn, audit: Audited) -> Response:
    """Create a token; it lasts until revoked or expired. Only this response has it."""
    ends = body.ends(utc_now())
    row, secret = access.issue(audit, body.name, body.role, ends)
    token = wire.Token.model_validate(row, from_attributes=True)
    return json_response(wire.NewToken(**dict(token), token=secret), 201, NO_STORE)


@tokens_router.delete("/tokens/{token_id}", status_code=204)
def revoke_token(
    caller: Admin,
    token_id: RowId,
    session: WriteSession,
    services: AppServices,
    audit: Audited,
) -> Response:
    """Revoke a token; the sessions that it opened end as well."""
    access.revoke(audit, token_id)
    make_room(services, session)
    services.one(RecentCallers).forget_on_commit(session)
    return Response(status_code=204)
