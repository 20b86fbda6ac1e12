"""Server-sent events, as far as the server sends them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple


class Event(NamedTuple):
    """One event; `id` is what to show to go on after it."""

    name: str
    id: str
    data: str


def read_events(lines: Iterable[str]) -> Iterator[Event]:
    """Events from the lines of a stream; one without its empty line did not come."""
    name, number, data = "message", "", list[str]()
    for line in lines:
        if not line:
            if data:
                yield Event(name, number, "\n".join(data))
            name, data = "message", []
            continue
        key, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if key == "event":
            name = value
        elif key == "id":
            number = value
        elif key == "data":
            data.append(value)
