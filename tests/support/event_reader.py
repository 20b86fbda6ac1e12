"""Reads server-sent events as a browser does, for tests of jobs' progress."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from tests.support.api import BASE, Api


@dataclass(frozen=True)
class Event:
    """One event, or (without a name) a comment."""

    name: str
    id: str
    data: Any


@contextmanager
def open_events(
    api: Api, job_id: int, last: str | None = None, *, of: str = "runs"
) -> Iterator[Iterator[Event]]:
    """Yield the events of a job as they arrive, until the block or the stream ends."""
    headers = {} if last is None else {"Last-Event-ID": last}
    url = f"{BASE}/{of}/{job_id}/events"
    with api.http.stream("GET", url, headers=headers) as response:
        assert response.status_code == 200, response.read()
        assert response.headers["content-type"].startswith("text/event-stream")
        # Kept in a name: the response closes when its last reader is deleted.
        stream = parsed(response.iter_lines())
        yield stream


def events(
    api: Api, job_id: int, last: str | None = None, *, of: str = "runs"
) -> list[Event]:
    """All events of a job up to its end, without comments."""
    with open_events(api, job_id, last, of=of) as stream:
        return [event for event in stream if event.name]


def parsed(lines: Iterator[str]) -> Iterator[Event]:
    """Parse lines of a stream into events, by the standard's rules.

    An empty line ends an event; a line that begins with a colon is a comment.
    """
    fields: dict[str, str] = {}
    for line in lines:
        if line:
            name, _, value = line.partition(": ")
            fields[name] = value
            continue
        if "retry" not in fields:
            data = json.loads(fields["data"]) if "data" in fields else None
            name, number = fields.get("event", ""), fields.get("id", "")
            yield Event(name, number, data)
        fields = {}
