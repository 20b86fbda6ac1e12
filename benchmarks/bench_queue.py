"""How fast are the queue, totals, previews, bulk answers and tables of a million boxes?

    python -m benchmarks.bench_queue [--requests 100] [--json]

Of tables: all boxes of 60,000, as a table and as a list of objects, by the client, and
what a page of 100 boxes costs the server's processor; ``--only-tables`` measures these
alone, without the million.

A real server on a port serves a copy of the dataset that ``bench_runs`` makes. Times
are from a request to the end of its answer, one at a time; the history of one box shows
what any request costs. The most doubtful ten thousand boxes are answered first.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import httpx

from benchmarks.measuring import (
    DATA,
    client_of,
    cpu_seconds,
    opened,
    parser_of,
    progress,
    quantile,
    served,
    show,
    store_million,
)
from tests.support.large_datasets import NAME, DatasetSpec, make_dataset
from tests.support.servers import RunningServer
from unghost import Client

ANSWERED = {"margin_max": 0.65, "review": "none"}
BULK = {"class": "car", "distance_max": 155, "review": "none"}
"""A little less than the hundred thousand boxes that one bulk answer may change."""
AIMS_MS = {"queue by": 50, "total": 50, "preview": 100, "quality": 200}
"""The aims, at most, for figures whose names contain these words."""
OF_TABLES = DatasetSpec("tables", frames=2400)
ORDERS = ("doubt", "random", "class", "audit")
FILTERS: dict[str, dict[str, Any]] = {
    "": {},
    ", rejected walkers": {"verdict": "rejected", "class": "walker"},
    ", toss-ups": {"toss_up": True},
    ", margin up to 3": {"margin_max": 3},
}


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--boxes", type=int, default=1_000_000)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--requests", type=int, default=100)
    parser.add_argument("--only-tables", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        if not options.only_tables:
            with opened(options.data) as context:
                store_million(context, options.boxes)
            shutil.copytree(options.data, data)
        with opened(data) as context:
            make_dataset(context, OF_TABLES, progress)
        with served(data) as server:
            figures = dict(tables(server, options.requests))
            if not options.only_tables:
                figures |= measured(server, options.requests)
    for part, aim in AIMS_MS.items():
        if any(part in name for name in figures):
            figures[f"{part}: aim, at most [ms]"] = aim
    show(figures, as_json=options.json)


def measured(server: RunningServer, requests: int) -> Iterator[tuple[str, float]]:
    """Each figure with its name."""
    client = client_of(server)
    _, answers, _ = answer_all(client, ANSWERED)
    yield "boxes answered before", answers
    box_id = client.get("/boxes", params={"dataset": NAME, "limit": 1}).json()
    path = f"/boxes/{box_id['items'][0]['box_id']}/history"
    yield "one small response, p95 [ms]", p95(requests, lambda _: client.get(path))
    for order in ORDERS:
        for name, filters in FILTERS.items():
            if order == "audit" and name:
                continue
            body = {"order": order, "filters": filters}
            took = p95(requests, queue_requests(client, body))
            yield f"queue by {order}{name}, p95 [ms]", took
    for name, filters in (
        ("by tallies", {"verdict": "rejected", "review": "undecided"}),
        ("of a range", {"match_min": 5, "match_max": 40, "review": "undecided"}),
    ):
        query = {"dataset": NAME, "limit": 1, "count": "true", **filters}
        took = p95(requests, partial(listed, client, query))
        yield f"total {name}, p95 [ms]", took

    def dragged(number: int) -> httpx.Response:
        config = {"threshold_small_box": 5 + number % 40 / 4}
        body = {"config": config, "limit": 50, "bins": 100}
        return client.post(f"/datasets/{NAME}/preview", json=body)

    yield "preview while dragging, p95 [ms]", p95(requests, dragged)
    took = p95(10, lambda _: client.get(f"/datasets/{NAME}/quality"))
    yield "quality of these answers, p95 [ms]", took
    batch, boxes, took = answer_all(client, BULK)
    yield "boxes of one bulk answer", boxes
    yield "the bulk answer [s]", took
    begun = time.perf_counter()
    client.post(f"/review-batches/{batch}/undo").raise_for_status()
    yield "undoing it [s]", time.perf_counter() - begun


def p95(requests: int, request: Callable[[int], httpx.Response]) -> float:
    """Milliseconds, after one request that fills what is kept in memory."""
    request(0).raise_for_status()
    times = []
    for number in range(requests):
        begun = time.perf_counter()
        request(number).raise_for_status()
        times.append(1000 * (time.perf_counter() - begun))
    return quantile(times, 0.95)


def tables(server: RunningServer, requests: int) -> Iterator[tuple[str, float]]:
    """All boxes of a dataset by the client, and what one page costs the server."""
    with Client(server.url, server.token) as client:
        boxes, took = timed(lambda: client.boxes(OF_TABLES.name).columns())
        yield "boxes of the table", len(boxes["box_id"])
        yield "all of them as a table [s]", took
        _, as_arrow = timed(lambda: client.boxes(OF_TABLES.name).to_arrow())
        yield "all of them for Arrow [s]", as_arrow
        _, as_objects = timed(lambda: list(client.boxes(OF_TABLES.name)))
        yield "all of them as objects [s]", as_objects
        yield "objects take so many times longer", as_objects / took
    plain = client_of(server)
    for name, path in (("objects", "/boxes"), ("columns", "/boxes/table")):
        query = {"dataset": OF_TABLES.name, "limit": "100"}
        for _ in range(5):
            plain.get(path, params=query).raise_for_status()
        before = cpu_seconds(server.process.pid)
        for _ in range(requests):
            plain.get(path, params=query).raise_for_status()
        cost = (cpu_seconds(server.process.pid) - before) / requests
        yield f"processor for 100 boxes as {name} [ms]", 1000 * cost


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """The result, and the shortest of three times."""
    times = []
    for _ in range(3):
        begun = time.perf_counter()
        result = work()
        times.append(time.perf_counter() - begun)
    return result, min(times)


def queue_requests(
    client: httpx.Client, body: dict[str, Any]
) -> Callable[[int], httpx.Response]:
    """Request the next ten boxes as the page does, excluding the ten that it has."""
    loaded: list[int] = []

    def request(_: int) -> httpx.Response:
        answer = client.post(f"/datasets/{NAME}/queue", json=body | {"exclude": loaded})
        loaded[:] = [item["box_id"] for item in answer.json()["items"]]
        return answer

    return request


def listed(client: httpx.Client, query: dict[str, Any], _: int) -> httpx.Response:
    return client.get("/boxes", params=query)


def answer_all(client: httpx.Client, filters: dict[str, Any]) -> tuple[int, int, float]:
    """Answer all boxes of a filter: id of the bulk answer, its boxes, the seconds."""
    query = {"dataset": NAME, "limit": 1, "count": "true", **filters}
    seen = client.get("/boxes", params=query).json()
    body = {"dataset": NAME, "filter": filters, "verdict": "keep"}
    begun = time.perf_counter()
    answer = client.post("/reviews/bulk", json=body | {"snapshot": seen["snapshot"]})
    took = time.perf_counter() - begun
    answer.raise_for_status()
    return answer.json()["id"], seen["total"], took


if __name__ == "__main__":
    main()
