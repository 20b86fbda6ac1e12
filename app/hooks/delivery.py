"""Delivers what is due to hooks, signed as Standard Webhooks says.

Each service looks every second. One process at a time delivers to a hook: it holds a
lease, of the kind that drivers of jobs hold (`app.jobs.leases`). What is delivered is a
row, so that another process, or the next start, goes on if this one ends; the receiver
may then get the same `webhook-id` twice.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import hmac
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from datetime import timedelta
from functools import cache, partial
from typing import Final

import httpx

from app.background import Task, repeating
from app.context import ServiceContext
from app.db.base import utc_now
from app.db.tables import Hook, HookDelivery
from app.engine.chunk import Job, Stop
from app.errors import Unprocessable
from app.hooks.queries import (
    DeliveryRepository,
    HookRepository,
    PendingReviewRepository,
)
from app.hooks.service import SECRET_PREFIX, allowed_url
from app.jobs.leases import LeaseLost, Leases
from app.logs import server_log
from app.package import VERSION
from app.settings import Settings

EVERY_S: Final = 1.0
ANSWER_WITHIN_S: Final = 15.0
"""Seconds that a receiver has for its whole response."""
PAUSES_S: Final = (2, 30, 120, 600, 1800, 7200, 18_000, 36_000)
"""Seconds before each further attempt; after the last one, a delivery is given up."""
AT_ONCE: Final = 8
"""Hooks to which one process delivers at the same time."""
_KIND: Final = "hook"
"""What leases call it."""
_SUCCESS: Final = range(200, 300)
_REDIRECTS: Final = range(300, 400)


@contextmanager
def delivering(context: ServiceContext) -> Iterator[None]:
    """Deliver what is due until the block ends; attempts under way are abandoned."""
    stop = Stop()
    work = partial(deliver_due, context, stop)
    with repeating(context, Task("hooks", "deliver to hooks", work, EVERY_S)):
        try:
            yield
        finally:
            stop.set()


def deliver_due(context: ServiceContext, stop: Stop) -> None:
    """Queue the events of reviewed datasets, and try each delivery that is due."""
    with context.database.read() as session:
        begun, over = PendingReviewRepository(session).changes()
    if begun or over:
        with context.database.write() as session:
            pending = PendingReviewRepository(session)
            for dataset_id in sorted(begun):
                pending.begin(dataset_id)
            for dataset_id in sorted(over):
                if (dataset := pending.end(dataset_id)) is not None:
                    hooks = HookRepository(session).told("dataset.reviewed", dataset_id)
                    url = f"/api/v1/datasets/{dataset.name}"
                    data = {"dataset": dataset.name, "url": url}
                    DeliveryRepository(session).queue(hooks, "dataset.reviewed", data)
    with context.database.read() as session:
        due = DeliveryRepository(session).hooks_due(utc_now())
    if due:
        with ThreadPoolExecutor(AT_ONCE, "hook") as pool:
            list(pool.map(partial(_deliver, context, stop), due))


def signature(secret: str, webhook_id: str, timestamp: int, body: str) -> str:
    """The header `webhook-signature`: an HMAC-SHA256 of id, time and body."""
    key = base64.b64decode(secret.removeprefix(SECRET_PREFIX))
    signed = f"{webhook_id}.{timestamp}.{body}".encode()
    digest = hmac.new(key, signed, hashlib.sha256).digest()
    return f"v1,{base64.b64encode(digest).decode('ascii')}"


def _deliver(context: ServiceContext, stop: Stop, hook_id: int) -> None:
    """Try what is due for one hook, until an attempt fails."""
    database = context.database
    try:
        with context.one(Leases).driving(database, Job(_KIND, hook_id)) as lease:
            with database.write() as session:
                lease.take(session)
                due = DeliveryRepository(session).due(hook_id, utc_now())
            for delivery, hook in due:
                if stop.is_set():
                    return
                lease.check()
                status, failure = _send(context.settings, stop, hook, delivery)
                pause_s = PAUSES_S[delivery.attempts : delivery.attempts + 1]
                due_at = None
                if failure is not None and pause_s:
                    due_at = utc_now() + timedelta(seconds=pause_s[0])
                with database.write() as session:
                    lease.require(session)
                    DeliveryRepository(session).note_attempt(
                        delivery.id, status, failure, due_at
                    )
                if failure is not None:
                    server_log.warning("hook %d: %s", hook_id, failure)
                    return
    except (LeaseLost, asyncio.CancelledError):
        return  # another process delivers to this hook, or the service is stopping


def _send(
    settings: Settings, stop: Stop, hook: Hook, delivery: HookDelivery
) -> tuple[int | None, str | None]:
    """The status of the response to one attempt, and why it failed (None: it did not).

    Whether the host is allowed is checked again: the settings may be others than when
    the hook was registered. Raises asyncio.CancelledError if the service is stopping:
    then the attempt does not count.
    """
    now, webhook_id, body = int(time.time()), delivery.webhook_id, delivery.body
    headers = {
        "Content-Type": "application/json",
        "User-Agent": f"unghost/{VERSION}",
        "webhook-id": webhook_id,
        "webhook-timestamp": str(now),
        "webhook-signature": signature(hook.secret, webhook_id, now, body),
    }
    try:
        url = allowed_url(settings, hook.url)
        post = _post(stop, url, headers, body.encode())
        status = asyncio.run(asyncio.wait_for(post, ANSWER_WITHIN_S))
    except Unprocessable as exc:
        return None, exc.detail[:300]
    except asyncio.TimeoutError:
        return None, f"no response within {ANSWER_WITHIN_S:.0f} seconds"
    except (httpx.HTTPError, OSError) as exc:
        cause: BaseException = exc
        while cause.__cause__ is not None:  # the last one names address and reason
            cause = cause.__cause__
        return None, f"no response: {str(cause) or type(cause).__name__}"[:300]
    if status in _SUCCESS:
        return status, None
    redirect = ", and redirects are not followed" if status in _REDIRECTS else ""
    return status, f"the receiver responded with {status}{redirect}"


async def _post(
    stop: Stop, url: httpx.URL, headers: dict[str, str], body: bytes
) -> int:
    loop, task = asyncio.get_running_loop(), asyncio.current_task()
    assert task is not None

    def cancel() -> None:
        with suppress(RuntimeError):  # it has just ended
            loop.call_soon_threadsafe(task.cancel)

    # The content of the response is not read, and no proxy of the environment is used.
    client = httpx.AsyncClient(
        verify=_authorities(), trust_env=False, timeout=ANSWER_WITHIN_S
    )
    with stop.calling(cancel):
        if stop.is_set():
            raise asyncio.CancelledError
        async with (
            client,
            client.stream("POST", url, content=body, headers=headers) as response,
        ):
            return response.status_code


_authorities: Final = cache(httpx.create_ssl_context)
"""The authorities that receivers' certificates are checked with."""
