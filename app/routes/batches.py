"""Many frames in one request: a tar in and, meanwhile, a line of JSON per frame out."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import AbstractContextManager
from typing import Annotated, Any, Final

from fastapi import Query, Request, Response
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect
from starlette.types import Receive, Scope, Send

from app.context import ServiceContext
from app.errors import UnsupportedMedia
from app.http.bodies import UntilStopped
from app.http.deps import AppServices, CurrentPrincipal
from app.http.middleware import BODY_ALLOWANCE
from app.http.problems import problem_of
from app.http.routing import LARGE_BODY, ApiRouter
from app.incoming import HeldBytes
from app.logs import current_request_id
from app.routes.datasets import DatasetName
from app.services.active import PlanCache
from app.services.batch_work import BatchOf, FrameLine
from app.services.batches import ArchiveFrames, BatchIntake
from app.services.open_batches import OpenBatches
from app.storage.room import require_room

ARCHIVE: Final = "application/x-tar"
LINES: Final = "application/x-ndjson"

router = ApiRouter(prefix="/api/v1", tag="frames")

_BODY: Final = {
    "requestBody": {
        "required": True,
        "content": {ARCHIVE: {"schema": {"type": "string", "format": "binary"}}},
    }
}
_ANSWER: Final[dict[int | str, dict[str, Any]]] = {
    200: {
        "content": {LINES: {"schema": {"type": "string"}}},
        "description": "A line per frame as soon as it is stored, and a last one.",
    }
}


@router.post(
    "/datasets/{dataset}/batches",
    response_class=Response,
    responses=_ANSWER,
    openapi_extra={**LARGE_BODY, **_BODY},
)
async def post_batch(
    dataset: DatasetName,
    request: Request,
    principal: CurrentPrincipal,
    services: AppServices,
    replace: Annotated[
        bool, Query(description="Store other content as the next revision.")
    ] = False,
) -> Response:
    """Store the frames of a tar while it comes; each is answered once it is durable."""
    _expect_archive(request)
    return BatchAnswer(request, services, BatchOf(dataset, principal, replace))


def _expect_archive(request: Request) -> None:
    media_type = request.headers.get("content-type", "")
    if media_type.partition(";")[0].strip().lower() != ARCHIVE:
        raise UnsupportedMedia(
            f"the body must be {ARCHIVE}, it says {media_type or 'nothing'!r}"
        )
    coding = request.headers.get("content-encoding", "identity")
    if coding.lower() != "identity":
        raise UnsupportedMedia(
            f"the body must not be encoded, it says {coding[:80]!r}; images are "
            "compressed already"
        )


class BatchAnswer(Response):
    """Reads the request while it answers; nothing else may listen to the request."""

    media_type = LINES

    def __init__(
        self, request: Request, services: ServiceContext, batch: BatchOf
    ) -> None:
        super().__init__()
        del self.headers["content-length"]
        self._request, self._services, self._batch = request, services, batch

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """What is wrong before the first frame is a problem, as everywhere."""
        services = self._services
        with self._place():
            await run_in_threadpool(self._require_dataset)
            stop = services.engine.stopping
            pieces = UntilStopped(self._request.stream(), stop)
            with stop.telling(pieces.wake):
                held: HeldBytes = scope[BODY_ALLOWANCE].held
                frames = ArchiveFrames(services.settings, pieces, held)
                await frames.begin()
                await self._answer(frames, send)

    def _place(self) -> AbstractContextManager[None]:
        settings = self._services.settings
        return self._services.one(OpenBatches).enter(
            self._request.state.principal.token_id,
            most=settings.max_open_batches,
            most_of_one=settings.max_open_batches_per_token,
        )

    async def _answer(self, frames: ArchiveFrames, send: Send) -> None:
        await send(
            {
                "type": "http.response.start",
                "status": self.status_code,
                "headers": self.raw_headers,
            }
        )
        async for lines in self._lines(frames):
            await send({"type": "http.response.body", "body": lines, "more_body": True})
        await send({"type": "http.response.body", "body": b""})

    def _require_dataset(self) -> None:
        require_room(self._services.settings, self._services.storage)
        with self._services.database.read() as session:
            self._services.one(PlanCache).active(session, self._batch.dataset)

    async def _lines(self, frames: ArchiveFrames) -> AsyncIterator[bytes]:
        places = self._request.app.state.batches
        intake = BatchIntake(self._services, self._batch, places)
        told: Counter[str] = Counter(stored=0, same=0, refused=0)
        end: dict[str, Any] = {"end": True}
        try:
            async for lines in intake.lines(aiter(frames)):
                yield b"".join([self._told(line, told) for line in lines])
        except ClientDisconnect:
            return  # nobody is left to be told
        except Exception as error:
            end["problem"] = self._problem(error)
        yield _line({**end, "frames": told.total(), **told})

    def _told(self, line: FrameLine, told: Counter[str]) -> bytes:
        status = self._status(line)
        self._request.app.state.metrics.observe_frame(status)
        told[_KINDS.get(status, "refused")] += 1
        return _line(self._described(line, status))

    def _status(self, line: FrameLine) -> int:
        if line.error is not None:
            return problem_of(line.error).status
        return 201 if line.created else 200

    def _described(self, line: FrameLine, status: int) -> dict[str, Any]:
        described = {
            "key": line.key,
            "status": status,
            "frame_id": line.frame_id,
            "decisions": line.verdicts,
        }
        if line.error is not None:
            described["problem"] = self._problem(line.error)
        return described

    def _problem(self, error: Exception) -> dict[str, Any]:
        return problem_of(error).document(
            instance=self._request.url.path, request_id=current_request_id.get()
        )


_KINDS: Final = {201: "stored", 200: "same"}


def _line(value: dict[str, Any]) -> bytes:
    return json.dumps(value, ensure_ascii=False).encode() + b"\n"
