"""multipart/form-data into memory: bounded while it arrives, copied once."""

from __future__ import annotations

from collections.abc import AsyncIterable
from dataclasses import dataclass, field
from typing import Final

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header

from app.errors import BadRequest, TooLarge
from app.pieces import Pieces

MOST_MEDIA_TYPE: Final = 1024
"""Characters of a Content-Type; taking apart a long one takes long."""
MOST_HEADERS: Final = 8
"""Of one part; forms have two or three."""
MOST_HEADER_BYTES: Final = 4096
"""Of one header of a part: its names are read as often as it has any."""


@dataclass(frozen=True)
class PartLimits:
    """What a form may be at most."""

    max_parts: int
    max_part_bytes: int


@dataclass(frozen=True)
class Part:
    """A field or a file of a form; a file's own name says nothing that is needed."""

    name: str
    content: bytes


async def read_parts(
    media_type: str, stream: AsyncIterable[bytes], limits: PartLimits
) -> list[Part]:
    """The parts of a form in the order they were sent.

    Parameters
    ----------
    media_type : str
        The Content-Type, which names the boundary.
    stream : chunks of the body
    limits : PartLimits

    Raises
    ------
    BadRequest
        ``bad_multipart``: not a form, or one cut short.
    TooLarge
        More parts than allowed, or one grew beyond its limit; the rest is not read.
    """
    form = _Form(limits)
    try:
        parser = MultipartParser(
            _boundary(media_type),
            form.callbacks(),  # type: ignore[arg-type]  # a dict of just these names
            max_header_count=MOST_HEADERS,
            max_header_size=MOST_HEADER_BYTES,
        )
        async for chunk in stream:
            parser.write(chunk)
    except FormParserError as error:
        raise _unreadable(str(error)) from error
    if not form.is_complete:
        raise _unreadable("its last boundary is missing")
    return form.parts


def _boundary(media_type: str) -> bytes:
    if len(media_type) > MOST_MEDIA_TYPE:
        raise _unreadable(
            f"its Content-Type has {len(media_type)} characters; "
            f"expected at most {MOST_MEDIA_TYPE}"
        )
    _, options = parse_options_header(media_type)
    boundary = options.get(b"boundary")
    if not boundary:
        raise _unreadable("it has no boundary")
    return boundary


def _unreadable(reason: str) -> BadRequest:
    return BadRequest(
        f"the multipart body cannot be read: {reason}", code="bad_multipart"
    )


@dataclass
class _Form:
    """What the parser has found so far."""

    limits: PartLimits
    parts: list[Part] = field(default_factory=list)
    is_complete: bool = False

    def callbacks(self) -> dict[str, object]:
        """Under the names that the parser calls them by."""
        return {
            "on_part_begin": self._begin,
            "on_header_field": self._header_field,
            "on_header_value": self._header_value,
            "on_header_end": self._header_end,
            "on_headers_finished": self._headers_finished,
            "on_part_data": self._data,
            "on_part_end": self._end,
            "on_end": self._finish,
        }

    def _begin(self) -> None:
        if len(self.parts) == self.limits.max_parts:
            raise TooLarge(f"the form has more than {self.limits.max_parts} parts")
        self._name = ""
        self._disposition = self._header = self._value = b""
        self._content = Pieces()

    def _header_field(self, data: bytes, start: int, end: int) -> None:
        self._header += data[start:end]

    def _header_value(self, data: bytes, start: int, end: int) -> None:
        self._value += data[start:end]

    def _header_end(self) -> None:
        if self._header.lower() == b"content-disposition":
            self._disposition = self._value
        self._header = self._value = b""

    def _headers_finished(self) -> None:
        _, options = parse_options_header(self._disposition)
        if b"name" not in options:
            raise _unreadable("a part has no name")
        self._name = options[b"name"].decode("utf-8", "replace")

    def _data(self, data: bytes, start: int, end: int) -> None:
        if len(self._content) + end - start > self.limits.max_part_bytes:
            raise TooLarge(
                f"part {self._name!r} is larger than {self.limits.max_part_bytes} bytes"
            )
        self._content += memoryview(data)[start:end]

    def _end(self) -> None:
        self.parts.append(Part(self._name, bytes(self._content)))

    def _finish(self) -> None:
        self.is_complete = True
