"""Hooks: registering them, and the addresses that they may have."""

from __future__ import annotations

import base64
import secrets
from typing import Final

import httpx
from sqlalchemy.orm import Session

from app.access.audit import AuditAction, AuditTrail
from app.catalog.datasets import DatasetRepository
from app.db.base import insert_row, response_of
from app.db.tables import Hook, HookDelivery
from app.errors import Unprocessable
from app.hooks.queries import DeliveryRepository, HookRepository
from app.settings import Settings, bracketed
from unghost.wire import hooks as wire
from unghost.wire.words import DeliveryState

SECRET_PREFIX: Final = "whsec_"
_SECRET_BYTES: Final = 32


def allowed_url(settings: Settings, url: str) -> httpx.URL:
    """The address of a hook, whose host `UNGHOST_HOOK_HOSTS` lists.

    Raises Unprocessable if it is no address of HTTP, or has a name, a password or a
    fragment, or (``hook_host``) if its host is not listed.
    """
    try:
        address = httpx.URL(url)
    except httpx.InvalidURL as exc:
        raise Unprocessable(f"url {url[:80]!r} is no address: {exc}") from exc
    if address.scheme not in ("http", "https") or not address.raw_host:
        raise Unprocessable(
            f"url: expected an address such as https://ci.example.org/unghost, found "
            f"{url[:80]!r}"
        )
    if address.userinfo or address.fragment:
        raise Unprocessable(
            "url: expected an address without a name, a password and a fragment: "
            "whoever receives it checks the signature"
        )
    host = bracketed(address.raw_host.decode("ascii").lower())
    port = address.port or {"http": 80, "https": 443}[address.scheme]
    if not {host, f"{host}:{port}"} & set(settings.hook_hosts):
        listed = ", ".join(settings.hook_hosts) or "none"
        raise Unprocessable(
            f"this server sends nothing to {host}: its admin has to start it with "
            f"{host} in UNGHOST_HOOK_HOSTS, which lists {listed}",
            code="hook_host",
        )
    return address


def create_hook(
    audit: AuditTrail, settings: Settings, request: wire.HookIn
) -> wire.NewHook:
    """Register a hook; only the result has its secret.

    Raises Unprocessable as `allowed_url`, and NotFound if there is no such dataset.
    """
    allowed_url(settings, request.url)
    dataset = None
    if request.dataset is not None:
        dataset = DatasetRepository(audit.session).named(request.dataset)
    key = base64.b64encode(secrets.token_bytes(_SECRET_BYTES)).decode("ascii")
    secret = SECRET_PREFIX + key
    hook = Hook(
        url=request.url,
        events=list(dict.fromkeys(request.events)),
        dataset_id=None if dataset is None else dataset.id,
        secret=secret,
        created_by=audit.name,
    )
    insert_row(audit.session, hook)
    audit.note(AuditAction.HOOK_CREATED, hook.id, url=hook.url, dataset=request.dataset)
    shown = describe_hook(hook, request.dataset)
    return wire.NewHook(**dict(shown), secret=secret)


def delete_hook(audit: AuditTrail, hook_id: int) -> None:
    """Delete a hook with its log; what is due is not sent any more."""
    hooks = HookRepository(audit.session)
    hook = hooks.with_id(hook_id)
    hooks.delete(hook)
    audit.note(AuditAction.HOOK_DELETED, hook_id, url=hook.url)


def ping(session: Session, hook_id: int) -> wire.Delivery:
    """Queue a trial delivery for a hook."""
    hook = HookRepository(session).with_id(hook_id)
    (row,) = DeliveryRepository(session).queue([hook], "ping", {"hook": hook_id})
    return describe_delivery(row)


def describe_hook(hook: Hook, dataset: str | None) -> wire.Hook:
    """A hook as responses show it."""
    return response_of(wire.Hook, hook, dataset=dataset)


def describe_delivery(row: HookDelivery) -> wire.Delivery:
    """A delivery as responses show it."""
    state: DeliveryState = "failed" if row.error else "delivered"
    if row.due_at is not None:
        state = "waiting"
    return response_of(wire.Delivery, row, state=state, status=row.answered)
