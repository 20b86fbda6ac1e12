"""JSON responses: pages of lists, and accepted runs and exports (202)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Final, Protocol, TypeVar

from fastapi import Depends, Query, Request, Response
from pydantic import TypeAdapter

from app.db.pages import NewestPage, id_of_cursor
from unghost.wire.model import ResponseModel
from unghost.wire.runs import Export, Run

NO_STORE: Final = {"Cache-Control": "no-store"}
"""Headers of a response with a secret: neither a cache nor the response kept for an
Idempotency-Key may hold it."""


class _HasId(Protocol):
    @property
    def id(self) -> int: ...


_Row = TypeVar("_Row", bound=_HasId)


@dataclass(frozen=True)
class NewestFirst(NewestPage):
    """The page of a list with the newest rows first that a request asks for."""

    request: Request

    def response(
        self,
        rows: Sequence[_Row],
        describe: Callable[[_Row], Mapping[str, object] | ResponseModel],
    ) -> Response:
        """The response with these rows: one more than fit if there is a next page."""
        listed = rows[: self.limit]
        following = str(listed[-1].id) if len(rows) > len(listed) else None
        return page_response(self.request, [describe(row) for row in listed], following)


async def newest_first(
    request: Request, limit: Limit = 100, cursor: Cursor = None
) -> NewestFirst:
    """The page that a request names by its parameters."""
    before_id = None if cursor is None else id_of_cursor(cursor)
    return NewestFirst(before_id, limit, request)


_JSON: Final = TypeAdapter(object)


def page_with_link(request: Request, page: object, next_cursor: str | None) -> Response:
    """A page as JSON, with a Link header to the next one."""
    headers = {}
    if next_cursor is not None:
        following = request.url.include_query_params(cursor=next_cursor)
        target = f"{following.path}?{following.query}"
        headers["Link"] = f'<{target}>; rel="next"'
    return json_response(page, headers=headers)


def page_response(
    request: Request,
    items: Sequence[Mapping[str, object] | ResponseModel],
    next_cursor: str | None,
    **more: object,
) -> Response:
    """A page of items as JSON, without validation; `more` are its other fields."""
    page = {"items": items, "next_cursor": next_cursor, **more}
    return page_with_link(request, page, next_cursor)


def json_response(
    content: object, status_code: int = 200, headers: Mapping[str, str] | None = None
) -> Response:
    """Values and models as JSON; four times as fast as JSONResponse for long ones."""
    return Response(
        _JSON.dump_json(content), status_code, headers, media_type="application/json"
    )


Newest = Annotated[NewestFirst, Depends(newest_first)]

Limit = Annotated[
    int, Query(ge=1, le=1000, description="Maximum number of items on a page.")
]
Cursor = Annotated[
    str | None,
    Query(max_length=2000, description="`next_cursor` of the page before this one."),
]


def accepted(job: Run | Export) -> Response:
    """A 202 with a run or an export, and its URL."""
    kind = "runs" if isinstance(job, Run) else "exports"
    return json_response(job, 202, {"Location": f"/api/v1/{kind}/{job.id}"})
