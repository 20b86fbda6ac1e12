"""The audit log. For admins; nobody can write it but by what they do."""

from __future__ import annotations

from fastapi import Response

from app.deps import ReadSession
from app.repositories.audit import AuditRepository
from app.routes.newest_first import Newest
from app.routing import ApiRouter
from app.schemas.pages import page_response
from app.security import Role
from unghost.wire.access import AuditEntry
from unghost.wire.model import Page

router = ApiRouter(prefix="/api/v1", tag="audit", read=Role.ADMIN, write=Role.ADMIN)


@router.get("/audit", response_model=Page[AuditEntry])
def list_audit(wanted: Newest, session: ReadSession) -> Response:
    """Who did what to tokens, data, configurations, jobs and many answers at once."""
    limit = wanted.page.limit
    found = AuditRepository(session).page(wanted.page)
    following = str(found[limit - 1].id) if len(found) > limit else None
    items = [
        AuditEntry.model_validate(entry, from_attributes=True)
        for entry in found[:limit]
    ]
    return page_response(wanted.request, items, following)
