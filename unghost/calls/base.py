"""What the methods of every resource need: send, read, page. Knows no resource."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, Protocol, TypeVar
from urllib.parse import quote

import httpx

from unghost.errors import unexpected
from unghost.reading import MissingKey, ResultT
from unghost.transport import API, Call, Params, Transport, body_of

PAGE_SIZE: Final = 500
_FIRST_POLL_S: Final = 0.05
_LONGEST_POLL_S: Final = 2.0


class _Work(Protocol):
    @property
    def finished(self) -> bool: ...


WorkT = TypeVar("WorkT", bound=_Work)


class Calls:
    """Base of the resources' methods: one transport, shared."""

    _transport: Transport

    def _get(
        self,
        kind: type[ResultT],
        path: str,
        params: Params | None = None,
        *,
        patience: int = 1,
    ) -> ResultT:
        call = Call("GET", path, params=params or {}, patience=patience)
        return self._call(kind, call)

    def _post(self, kind: type[ResultT], path: str, body: object = None) -> ResultT:
        return self._call(kind, Call("POST", path, json=body))

    def _call(self, kind: type[ResultT], call: Call) -> ResultT:
        response = self._transport.send(call)
        return read(kind, body_of(response), response)

    def _all(
        self, kind: type[ResultT], path: str, params: Params | None = None
    ) -> Iterator[ResultT]:
        """Every item of a list, page by page as they are asked for."""
        query = {"limit": PAGE_SIZE, **(params or {})}
        while True:
            response = self._transport.send(Call("GET", path, params=query))
            page = body_of(response)
            for item in _items(page, response):
                yield read(kind, item, response)
            cursor = page.get("next_cursor")
            if cursor is None:
                return
            query["cursor"] = cursor

    def _polled(
        self,
        fetch: Callable[[], WorkT],
        progress: Callable[[WorkT], object] | None,
        timeout_s: float | None,
    ) -> WorkT:
        """Ask again, ever more rarely, until the work has finished."""
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        pause_s = _FIRST_POLL_S
        while True:
            work = fetch()
            if progress is not None:
                progress(work)
            if work.finished:
                return work
            if deadline is not None and time.monotonic() + pause_s > deadline:
                raise TimeoutError(f"not finished after {timeout_s:g} s")
            self._transport.pause(pause_s)
            pause_s = min(_LONGEST_POLL_S, pause_s * 1.5)


def read(
    kind: type[ResultT], body: Mapping[str, Any], response: httpx.Response
) -> ResultT:
    """The typed result, or the error that says why the answer is none."""
    try:
        return kind.read(body)
    except (MissingKey, TypeError, AttributeError) as exc:
        raise unexpected(response, f"cannot be read: {exc}") from exc


def dataset_path(dataset: str, *rest: str) -> str:
    """The path of a dataset or of something in it."""
    return "/".join((f"{API}/datasets/{quote(dataset, safe='')}", *rest))


def frame_path(dataset: str, key: str) -> str:
    """The path of a frame by its key, whose slashes stay slashes."""
    return dataset_path(dataset, "frames", quote(key, safe="/"))


def _items(page: Mapping[str, Any], response: httpx.Response) -> list[Any]:
    items = page.get("items")
    if not isinstance(items, list):
        raise unexpected(response, "has no items")
    return items
