"""Lists that begin with what happened last: configurations, runs, exports, problems."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Query, Request, Response

from app.deps import MAX_ID
from app.repositories.newest import NewestPage, Row
from app.schemas.pages import Limit, page_response
from unghost.wire.model import ResponseModel


@dataclass(frozen=True)
class NewestFirst:
    """Which page was asked for, and how it is answered."""

    request: Request
    page: NewestPage

    def answer(
        self,
        rows: Sequence[Row],
        describe: Callable[[Row], Mapping[str, Any] | ResponseModel],
    ) -> Response:
        """The rows that `newest` found for this page."""
        listed = rows[: self.page.limit]
        following = str(listed[-1].id) if len(rows) > len(listed) else None
        return page_response(self.request, [describe(row) for row in listed], following)


async def newest_first(
    request: Request,
    limit: Limit = 100,
    cursor: Annotated[int | None, Query(ge=1, le=MAX_ID)] = None,
) -> NewestFirst:
    """The page that a request asks for."""
    return NewestFirst(request, NewestPage(cursor, limit))


Newest = Annotated[NewestFirst, Depends(newest_first)]
