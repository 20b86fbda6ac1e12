"""Routes of hooks and of the log of their deliveries; for admins."""

from __future__ import annotations

from fastapi import Response

from app.access.gate import Audited
from app.hooks import service as hooks
from app.hooks.queries import DeliveryRepository, HookRepository
from app.http.deps import Admin, AppServices, ReadSession, RowId
from app.http.pages import NO_STORE, Newest, json_response, page_response
from app.http.routing import ApiRouter
from app.http.transaction import WriteSession
from unghost.wire.hooks import Delivery, Hook, HookIn, NewHook
from unghost.wire.model import Page

router = ApiRouter(prefix="/api/v1", tag="hooks")


@router.get("/hooks", response_model=Page[Hook])
def list_hooks(caller: Admin, query: Newest, session: ReadSession) -> Response:
    """All hooks, newest first; without their secrets."""
    rows = HookRepository(session).page(query)
    listed = rows[: query.limit]
    following = str(listed[-1][0].id) if len(rows) > len(listed) else None
    items = [hooks.describe_hook(hook, dataset) for hook, dataset in listed]
    return page_response(query.request, items, following)


@router.post("/hooks", status_code=201, response_model=NewHook)
def create_hook(
    caller: Admin, body: HookIn, services: AppServices, audit: Audited
) -> Response:
    """Register a hook, to which events are sent. Only this response has its secret."""
    hook = hooks.create_hook(audit, services.settings, body)
    return json_response(hook, 201, NO_STORE)


@router.delete("/hooks/{hook_id}", status_code=204)
def delete_hook(caller: Admin, hook_id: RowId, audit: Audited) -> Response:
    """Delete a hook and its log; what waits for it is not sent any more."""
    hooks.delete_hook(audit, hook_id)
    return Response(status_code=204)


@router.get("/hooks/{hook_id}/deliveries", response_model=Page[Delivery])
def list_deliveries(
    caller: Admin, hook_id: RowId, query: Newest, session: ReadSession
) -> Response:
    """What was and will be sent to a hook, newest first; of those that are over, the
    newest 200."""
    hook = HookRepository(session).with_id(hook_id)
    rows = DeliveryRepository(session).page(hook.id, query)
    return query.response(rows, hooks.describe_delivery)


@router.post("/hooks/{hook_id}/ping", status_code=202, response_model=Delivery)
def ping_hook(caller: Admin, hook_id: RowId, session: WriteSession) -> Response:
    """Send an event `ping` to a hook, to try it; its log has the outcome."""
    return json_response(hooks.ping(session, hook_id), 202)
