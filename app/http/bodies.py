"""Reads bodies of requests within limits: JSON as a whole, multipart in pieces.

Multipart is read with `python_multipart` itself: Starlette's forms limit the size of
fields but not of files, and write large files to a temporary file before a limit is
checked. Here a part is refused as soon as it is too large.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterable, AsyncIterator, Callable
from dataclasses import dataclass, field
from typing import Final, TypeVar

from anyio import to_thread
from fastapi import Request
from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header

from app.engine.chunk import Stop
from app.errors import BadRequest, NotReady, TooLarge, Unprocessable
from app.http.deps import admission_of
from app.incoming import Pieces, in_turn
from filter_core.errors import JsonError
from filter_core.json_text import JsonLimits, read_json, repeated_key
from unghost.wire.model import Fault

Result = TypeVar("Result")

_SMALL_BYTES: Final = 4096
"""Up to this size, using a thread takes longer than parsing."""
_LIMITS: Final = JsonLimits(max_depth=32, max_values=320_000, max_keys=10_000)
"""No schema has more than a few dozen keys; each unknown one is reported as a fault.
The largest body is a bulk answer: 100,000 boxes with their revisions are 200,000
values."""


class StrictRequest(Request):
    """A request whose JSON is parsed within limits, without blocking the event loop."""

    async def json(self) -> object:
        """The body as a value.

        Raises Unprocessable: ``invalid_request``: it is not JSON, or exceeds a limit of
        `_LIMITS`.
        """
        content = await self.body()
        try:
            return await run_off_loop(self, content, _read)
        except JsonError as error:
            code = "json_invalid" if error.kind == JsonError.code else error.kind
            fault = Fault(pointer="", code=code, detail=error.detail)
            raise Unprocessable(
                error.detail, code="invalid_request", faults=[fault]
            ) from error


async def run_off_loop(
    request: Request, content: bytes, work: Callable[[bytes], Result]
) -> Result:
    """The result of ``work(content)``, called in a thread unless content is small."""
    if len(content) <= _SMALL_BYTES:
        return work(content)
    parsers = admission_of(request).parsers
    return await to_thread.run_sync(work, content, limiter=parsers)


def _read(content: bytes) -> object:
    def object_of(pairs: list[tuple[str, object]]) -> dict[str, object]:
        if (repeated := repeated_key(pairs)) is not None:
            raise ValueError(f"the key {repeated[:60]!r} twice")
        return dict(pairs)

    with in_turn(len(content)):
        return read_json(content, _LIMITS, object_pairs_hook=object_of)


RETRY_S: Final = 5


def stopping() -> NotReady:
    """The error for requests that arrive or are cut off while the service stops."""
    return NotReady("the service is stopping; try again later", retry_after_s=RETRY_S)


class UntilStopped:
    """The pieces of a body, until it ends or the service stops.

    `wake` interrupts the task that waits for the next piece. Raises NotReady: the
    service is stopping. Pieces received before can be used.
    """

    def __init__(self, pieces: AsyncIterator[bytes], stop: Stop) -> None:
        self._pieces, self._stop = pieces, stop
        self._loop = asyncio.get_running_loop()
        self._reader: asyncio.Task[object] | None = None
        self._is_woken = False

    def __aiter__(self) -> UntilStopped:
        """This object; iterating again continues after the last piece."""
        return self

    async def __anext__(self) -> bytes:
        """The next piece."""
        if self._stop.is_set():
            raise stopping()
        self._reader = asyncio.current_task()
        try:
            return await anext(self._pieces)
        except asyncio.CancelledError:
            if not self._is_woken:
                raise
            # From Python 3.11 on, a task counts as cancelled until this is called.
            uncancel = getattr(self._reader, "uncancel", None)
            if uncancel is not None:
                uncancel()
            raise stopping() from None
        finally:
            self._reader = None

    def wake(self) -> None:
        """Interrupt the task that waits for a piece; may be called by any thread."""

        def interrupt() -> None:
            if self._reader is not None:
                self._is_woken = True
                self._reader.cancel()

        self._loop.call_soon_threadsafe(interrupt)


MAX_MEDIA_TYPE_LENGTH: Final = 1024
"""Characters of a Content-Type; a longer one would take long to parse."""
MAX_PART_HEADERS: Final = 8
"""Headers of one part; usual forms have two or three."""
MAX_PART_HEADER_BYTES: Final = 4096
"""Bytes of one header of a part; parsing takes time quadratic in its parameters."""


async def read_parts(
    media_type: str,
    stream: AsyncIterable[bytes],
    *,
    max_parts: int,
    max_part_bytes: int,
) -> list[tuple[str, bytes]]:
    """The fields and files of a form, each with its name, in the order they were sent.

    The names of files are ignored. `media_type` is the Content-Type, which names the
    boundary; `max_part_bytes` is the maximum size of each part.

    Raises BadRequest: ``bad_multipart``: the body is not a form, or is incomplete;
    TooLarge: it has too many parts, or too large a part; the rest is not read.
    """
    if len(media_type) > MAX_MEDIA_TYPE_LENGTH:
        raise _unreadable(
            f"its Content-Type has {len(media_type)} characters; "
            f"expected at most {MAX_MEDIA_TYPE_LENGTH}"
        )
    boundary = parse_options_header(media_type)[1].get(b"boundary")
    if not boundary:
        raise _unreadable("it has no boundary")
    form = _Form(max_parts, max_part_bytes)
    try:
        parser = MultipartParser(
            boundary,
            form.callbacks(),  # type: ignore[arg-type]  # a dict of just these names
            max_header_count=MAX_PART_HEADERS,
            max_header_size=MAX_PART_HEADER_BYTES,
        )
        async for chunk in stream:
            parser.write(chunk)
    except FormParserError as error:
        raise _unreadable(str(error)) from error
    if not form.is_complete:
        raise _unreadable("its last boundary is missing")
    return form.parts


def _unreadable(reason: str) -> BadRequest:
    return BadRequest(
        f"the multipart body cannot be read: {reason}", code="bad_multipart"
    )


@dataclass
class _Form:
    """The parts that the parser has found so far."""

    max_parts: int
    max_part_bytes: int
    parts: list[tuple[str, bytes]] = field(default_factory=list)
    is_complete: bool = False

    def callbacks(self) -> dict[str, object]:
        """The callbacks of the parser, by its names for them."""
        return {name: getattr(self, name) for name in vars(_Form) if name[:3] == "on_"}

    def on_part_begin(self) -> None:
        if len(self.parts) == self.max_parts:
            raise TooLarge(f"the form has more than {self.max_parts} parts")
        self._name = ""
        self._disposition = self._header = self._value = b""
        self._content = Pieces()

    def on_header_field(self, data: bytes, start: int, end: int) -> None:
        self._header += data[start:end]

    def on_header_value(self, data: bytes, start: int, end: int) -> None:
        self._value += data[start:end]

    def on_header_end(self) -> None:
        if self._header.lower() == b"content-disposition":
            self._disposition = self._value
        self._header = self._value = b""

    def on_headers_finished(self) -> None:
        _, options = parse_options_header(self._disposition)
        if b"name" not in options:
            raise _unreadable("a part has no name")
        self._name = options[b"name"].decode("utf-8", "replace")

    def on_part_data(self, data: bytes, start: int, end: int) -> None:
        if len(self._content) + end - start > self.max_part_bytes:
            raise TooLarge(
                f"part {self._name!r} is larger than {self.max_part_bytes} bytes"
            )
        self._content += memoryview(data)[start:end]

    def on_part_end(self) -> None:
        self.parts.append((self._name, bytes(self._content)))

    def on_end(self) -> None:
        self.is_complete = True
