"""Tokens: who may come in. For admins."""

from __future__ import annotations

from fastapi import Request, Response

from app.db.base import utc_now
from app.deps import AppServices, Audited, ReadSession, RowId, WriteSession, make_room
from app.errors import BadRequest
from app.repositories.tokens import Tokens
from app.routing import ApiRouter
from app.schemas.pages import Cursor, Limit, page_response, written
from app.security import Role
from app.services import tokens
from unghost.wire.access import NewToken, Token, TokenIn
from unghost.wire.model import Page

router = ApiRouter(prefix="/api/v1", tag="tokens", read=Role.ADMIN, write=Role.ADMIN)


@router.get("/tokens", response_model=Page[Token])
def list_tokens(
    request: Request, session: ReadSession, limit: Limit = 100, cursor: Cursor = None
) -> Response:
    """All tokens, revoked ones included, oldest first. What they open with is gone.

    When one was last used is known to the minute.
    """
    if cursor is not None and not (cursor.isdecimal() and len(cursor) < 19):
        raise BadRequest("the cursor is damaged", code="bad_cursor")
    found = Tokens(session).page(after_id=int(cursor or 0), limit=limit + 1)
    following = str(found[limit - 1].id) if len(found) > limit else None
    items = [Token.model_validate(one, from_attributes=True) for one in found[:limit]]
    return page_response(request, items, following)


@router.post("/tokens", status_code=201, response_model=NewToken)
def create_token(body: TokenIn, audit: Audited) -> Response:
    """A new token. It is shown in this answer and never again; it ends in 90 days."""
    role, ends = Role(body.role), body.ends(utc_now())
    made, secret = tokens.issue(audit, body.name, role, ends)
    token = Token.model_validate(made, from_attributes=True)
    # no-store: neither a cache nor the answer kept for an Idempotency-Key holds it.
    shown = NewToken(**dict(token), token=secret)
    return written(shown, 201, {"Cache-Control": "no-store"})


@router.delete("/tokens/{token_id}", status_code=204)
def revoke_token(
    token_id: RowId, session: WriteSession, services: AppServices, audit: Audited
) -> Response:
    """Take a token back; the sessions that it opened end as well."""
    tokens.revoke(audit, token_id)
    make_room(services, session)
    services.callers.forget_on_commit(session)
    return Response(status_code=204)
