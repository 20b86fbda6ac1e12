"""The class `Call`, and decorators that turn descriptions of calls into methods.

A `Call` is data: a request, and a function that reads its response. Describing a call
sends nothing.
"""

from __future__ import annotations

import re
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping
from dataclasses import KW_ONLY, dataclass, field
from functools import wraps
from typing import (
    TYPE_CHECKING,
    Concatenate,
    Final,
    Generic,
    ParamSpec,
    Protocol,
    TypeAlias,
    TypeVar,
    overload,
)
from urllib.parse import unquote

import httpx

from unghost.client.errors import InvalidName, json_object, unexpected

if TYPE_CHECKING:
    from unghost.wire.model import Json

T = TypeVar("T")
S = TypeVar("S")
T_co = TypeVar("T_co", covariant=True)
P = ParamSpec("P")

Params: TypeAlias = Mapping[str, object]
"""Parameters of a query; None leaves one out."""

Files: TypeAlias = Mapping[str, tuple[str, bytes, str]]
"""Parts of a form: file name, content and media type, by the part's name."""

Read: TypeAlias = Callable[[httpx.Response], T]
"""Reads the result from a successful response, or raises UnexpectedAnswer."""

API: Final = "/api/v1"
"""Where the paths of all calls begin."""

PAGE_SIZE: Final = 500
"""Number of items that one request of a list fetches."""

MAX_JSON_BYTES: Final = 64 * 1024**2
"""Longer responses are refused: ten thousand boxes, explained, take half of it."""

MAX_FILE_BYTES: Final = 1024**3
"""The same for a stored file of a frame, which is read into memory."""


class JsonReader(Protocol[T_co]):
    """A class whose objects can be read from JSON."""

    def read(self, raw: Json, /) -> T_co:
        """The object; LookupError, ValueError, TypeError or AttributeError if none."""


@dataclass(frozen=True)
class Call(Generic[T]):
    """One request, from the root of the server, and what reads its response.

    It can be sent more than once, because its bodies are values and not streams. `read`
    makes the result from a response with a success status. `retried`: try again if the
    server does not respond or is busy; `repeatable`: also after a response was lost,
    although the server may have executed the request. A response of more than
    `max_bytes` is refused, unless it is streamed.

    Raises InvalidName if a part of the path is empty or consists of dots: httpx
    resolves such parts, so that the request would go to another address.
    """

    method: str
    path: str
    read: Read[T]
    _: KW_ONLY
    params: Params = field(default_factory=dict)
    json: object = None
    files: Files | None = None
    content: bytes | None = None
    headers: Mapping[str, str] = field(default_factory=dict)
    retried: bool = True
    repeatable: bool = True
    max_bytes: int = MAX_JSON_BYTES

    def __post_init__(self) -> None:
        parts = unquote(self.path).split("/")[1:]
        if not {"", ".", ".."}.isdisjoint(parts):
            raise InvalidName(
                f"{self.path!r} is no address: a name or a part of a key must not be "
                "empty, '.' or '..'"
            )


ItemsAndCursor: TypeAlias = tuple[Iterator[T], str | None]
"""Items of a list, read lazily, and the cursor of the next page; None: the last one."""


@dataclass(frozen=True)
class Listing(Generic[T]):
    """A list that the server returns in pages."""

    path: str
    item: JsonReader[T]
    params: Params = field(default_factory=dict)

    def page(self, cursor: str | None = None) -> Call[ItemsAndCursor[T]]:
        """The call for the first page, or for the page that the cursor names."""
        params = {"limit": PAGE_SIZE, **self.params}
        if cursor is not None:
            params["cursor"] = cursor
        return Call("GET", self.path, self._page, params=params)

    def _page(self, response: httpx.Response) -> ItemsAndCursor[T]:
        page = body_of(response)
        items = page.get("items")
        if not isinstance(items, list):
            raise unexpected(response, "has no items")
        read = (read_object(self.item.read, item, response) for item in items)
        return read, page.get("next_cursor")


class Sender(Protocol):
    """A client: it sends calls, and fetches the pages of lists."""

    def _send(self, call: Call[T], /) -> T: ...
    def _pages(self, listing: Listing[T], /) -> Iterator[T]: ...


class AsyncSender(Protocol):
    """A client whose results are awaited."""

    def _send(self, call: Call[T], /) -> Awaitable[T]: ...
    def _pages(self, listing: Listing[T], /) -> AsyncIterator[T]: ...


Describe: TypeAlias = Callable[..., object]
"""A method that describes a call; it does not use the client, which inherits it."""


def passed_to(name: str, described: str, result: str) -> Callable[[Describe], Describe]:
    """A decorator by which a client passes a description to one of its own methods.

    The pattern `described`, in the annotation of the description, becomes `result` in
    that of the method. The method of an `AsyncClient` returns an awaitable.
    """

    def decorate(describe: Describe) -> Describe:
        @wraps(describe)
        def method(client: object, /, *args: object, **kwargs: object) -> object:
            return getattr(client, name)(describe(client, *args, **kwargs))

        # `help` and `inspect.signature` read it from the function that `wraps` wraps.
        hints = describe.__annotations__
        hints["return"] = re.sub(described, result, hints["return"], count=1)
        return method

    return decorate


if TYPE_CHECKING:
    # To type checkers the decorators are descriptors: what a method returns depends on
    # the client. When the program runs they are the functions below, of the same names.

    class Endpoint(Generic[P, T]):
        """A method that sends a call."""

        def __init__(self, describe: Callable[Concatenate[S, P], Call[T]]) -> None: ...
        @overload
        def __get__(self, client: Sender, kind: object) -> Callable[P, T]: ...
        @overload
        def __get__(
            self, client: AsyncSender, kind: object
        ) -> Callable[P, Awaitable[T]]: ...
        def __get__(self, client: object, kind: object) -> object: ...

    class ListEndpoint(Generic[P, T]):
        """A method that iterates over a list."""

        def __init__(
            self, describe: Callable[Concatenate[S, P], Listing[T]]
        ) -> None: ...
        @overload
        def __get__(self, client: Sender, kind: object) -> Callable[P, Iterator[T]]: ...
        @overload
        def __get__(
            self, client: AsyncSender, kind: object
        ) -> Callable[P, AsyncIterator[T]]: ...
        def __get__(self, client: object, kind: object) -> object: ...

    endpoint, listing = Endpoint, ListEndpoint

else:
    endpoint = passed_to("_send", r"Call\[(.*)\]", r"\1")
    listing = passed_to("_pages", r"Listing\[", "Iterator[")


def fetched(kind: JsonReader[T], path: str, **params: object) -> Call[T]:
    """A call that fetches an object of a class; `params` are those of the query."""
    return Call("GET", path, result(kind), params=params)


def posted(
    kind: JsonReader[T], path: str, body: object = None, *, repeatable: bool = True
) -> Call[T]:
    """A call that sends a body as JSON, and gets an object of a class."""
    return Call("POST", path, result(kind), json=body, repeatable=repeatable)


def result(kind: JsonReader[T]) -> Read[T]:
    """Reads the JSON object of a response as an object of a class."""
    return answer(kind.read)


def answer(read: Callable[[Json], T]) -> Read[T]:
    """Reads the JSON object of a response with a function such as `JsonReader.read`."""
    return lambda response: read_object(read, body_of(response), response)


def content(response: httpx.Response) -> bytes:
    """Reads a response that is a file."""
    return response.content


def nothing(_: httpx.Response) -> None:
    """Ignores the content of a successful response."""


def read_object(read: Callable[[Json], T], raw: Json, response: httpx.Response) -> T:
    """The result of `read` for a part of a response; UnexpectedAnswer if it fails."""
    try:
        return read(raw)
    except (LookupError, ValueError, TypeError, AttributeError) as exc:
        raise unexpected(response, f"cannot be read: {exc}") from exc


def body_of(response: httpx.Response) -> Json:
    """The JSON object of a response; UnexpectedAnswer if it is none."""
    body = json_object(response)
    if body is None:
        raise unexpected(response, "is not a JSON object")
    return body


def query_of(params: Params) -> dict[str, str]:
    """The parameters of the query string: without None, each value as text."""
    return {key: _text(value) for key, value in params.items() if value is not None}


def _text(value: object) -> str:
    if isinstance(value, list | tuple):
        return ",".join(map(_text, value))  # the API separates several values so
    return str(value).lower() if isinstance(value, bool) else str(value)
