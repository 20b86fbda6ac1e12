"""Server-sent events of jobs, while the client is connected and its token is valid."""

from __future__ import annotations

import time
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import AbstractContextManager, aclosing
from functools import partial
from typing import Annotated, Final

from fastapi import Header, Request, Response
from fastapi.responses import StreamingResponse
from pydantic import BaseModel
from starlette.types import Receive, Scope, Send

from app.context import ServiceContext
from app.engine.chunk import Job
from app.errors import Forbidden, Unauthorised
from app.http.deps import authorise, settings_of
from app.jobs import events
from app.jobs.kind import AnyKind

EVENT_STREAM: Final = "text/event-stream"
_RETRY: Final = b"retry: 1000\n\n"
"""Milliseconds after which a browser that lost the stream reconnects."""
_STILL_HERE: Final = b": still here\n\n"
_MAX_DIGITS: Final = 18

LastEventId = Annotated[
    str | None,
    Header(description="The `id` of the last event received: continue after it."),
]


def events_of(model: type[BaseModel], what: str) -> dict[int | str, dict[str, object]]:
    """The responses of a route of events, with this model as their data."""
    schema = {
        "type": "object",
        "required": ["data", "event", "id"],
        "properties": {
            "event": {"enum": ["progress", "end"]},
            "id": {"type": "string", "pattern": "^[0-9]+$"},
            "data": {
                "type": "string",
                "contentMediaType": "application/json",
                "contentSchema": {"$ref": f"#/components/schemas/{model.__name__}"},
            },
        },
    }
    told = f"`progress` events with the {what} as data, then one `end`."
    return {
        200: {"content": {EVENT_STREAM: {"itemSchema": schema}}, "description": told},
        204: {"description": "There are no more events; do not reconnect."},
    }


async def watch(
    request: Request,
    services: ServiceContext,
    kind: AnyKind,
    job_id: int,
    last_event_id: str | None,
) -> Response:
    """Events of a job after the last one that the client has; raises NotFound."""
    job = Job(kind.table.job_kind, job_id)
    place = partial(services.one(events.Poller).watching, job, services.settings)
    after = number_of(last_event_id)
    with place():
        state = await events.newest(services, job)
    if state.finished and after >= events.end_number(state):
        return Response(status_code=204)
    return EventStream(
        _lines(request, events.job_events(services, job, after)), place()
    )


def number_of(last_event_id: str | None) -> int:
    """The number in a Last-Event-ID; anything else starts from the beginning."""
    text = last_event_id or ""
    is_number = text.isascii() and text.isdigit() and len(text) <= _MAX_DIGITS
    return int(text) if is_number else events.NOTHING_SEEN


class EventStream(StreamingResponse):
    """Lines of events; no proxy may buffer them.

    `place` is entered before the first byte is sent, so that a client that sees a
    response knows that its stream counts; it is left when the client disconnects.
    """

    def __init__(
        self, lines: AsyncIterator[bytes], place: AbstractContextManager[None]
    ) -> None:
        super().__init__(
            lines,
            media_type=EVENT_STREAM,
            headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
        )
        self._place = place

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the response; raises TooManyRequests if there is no place for it."""
        with self._place:
            await super().__call__(scope, receive, send)


async def _lines(
    request: Request, stream: AsyncGenerator[events.JobEvent | None, None]
) -> AsyncIterator[bytes]:
    pause = settings_of(request).event_heartbeat_s
    checked = sent = time.monotonic()
    yield _RETRY
    async with aclosing(stream):
        async for event in stream:
            now = time.monotonic()
            # A token may be revoked while its stream is open.
            if now - checked >= pause:
                checked = now
                try:
                    await authorise(request, "viewer")
                except (Forbidden, Unauthorised):
                    return
            if event is not None:
                sent, data = now, event.state.model_dump_json()
                head = f"event: {event.name}\nid: {event.number}\n"
                yield f"{head}data: {data}\n\n".encode()
            elif now - sent >= pause:
                sent = now
                yield _STILL_HERE
