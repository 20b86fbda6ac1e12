"""Bodies of requests that are read as a whole: beside the event loop, within limits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeVar

from anyio import CapacityLimiter, to_thread
from fastapi import Request

from app.errors import Fault, Unprocessable
from app.services.json_turns import in_turn
from filter_core.errors import JsonError
from filter_core.json_text import JsonLimits, read_json

Result = TypeVar("Result")

MAX_READERS: Final = 2
"""Large bodies that are parsed at the same time; the others wait without a thread."""
_SMALL_BYTES: Final = 4096
"""Up to here a thread costs more than the work."""
_LIMITS: Final = JsonLimits(max_depth=32, max_values=320_000, max_keys=10_000)
"""No schema has more than a few dozen keys; each unknown one would be a fault. A
dataset's ignore mask of a hundred polygons, of a thousand points each, is 300,000
values, and nothing else comes near it."""


class StrictRequest(Request):
    """A request whose JSON is read within limits, and beside the event loop."""

    async def json(self) -> object:
        """The body as a value.

        Raises
        ------
        Unprocessable
            ``invalid_request``: it is not JSON, or more of it than is read.
        """
        content = await self.body()
        try:
            return await beside_the_loop(self, content, _read)
        except JsonError as error:
            code = "json_invalid" if error.kind == JsonError.code else error.kind
            fault = Fault("", code, error.detail)
            raise Unprocessable(
                error.detail, code="invalid_request", faults=[fault]
            ) from error


async def beside_the_loop(
    request: Request, content: bytes, work: Callable[[bytes], Result]
) -> Result:
    """What `work` makes of a body; in a thread unless that is small."""
    if len(content) <= _SMALL_BYTES:
        return work(content)
    readers: CapacityLimiter = request.app.state.readers
    return await to_thread.run_sync(work, content, limiter=readers)


def _read(content: bytes) -> object:
    with in_turn(len(content)):
        return read_json(content, _LIMITS)
