"""Lists: how a page is asked for and how it is answered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Final

from fastapi import Query, Request, Response
from pydantic import TypeAdapter

from unghost.wire.model import ResponseModel

Limit = Annotated[int, Query(ge=1, le=1000, description="Most items of a page.")]
Cursor = Annotated[
    str | None,
    Query(max_length=2000, description="`next_cursor` of the page before this one."),
]


_JSON: Final = TypeAdapter(Any)


def written(
    content: object, status_code: int = 200, headers: Mapping[str, str] | None = None
) -> Response:
    """Values and models as JSON: four times as fast as JSONResponse, for long ones."""
    return Response(
        _JSON.dump_json(content), status_code, headers, media_type="application/json"
    )


def page_response(
    request: Request,
    items: Sequence[Mapping[str, Any] | ResponseModel],
    next_cursor: str | None,
    **more: object,
) -> Response:
    """A page as JSON, with a Link to the next one; rows are not validated again."""
    page = {"items": items, "next_cursor": next_cursor, **more}
    return linked(request, page, next_cursor)


def linked(request: Request, page: object, next_cursor: str | None) -> Response:
    """A page that says more than its items, with a Link to the next one."""
    headers = {}
    if next_cursor is not None:
        following = request.url.include_query_params(cursor=next_cursor)
        target = f"{following.path}?{following.query}"
        headers["Link"] = f'<{target}>; rel="next"'
    return written(page, headers=headers)
