"""With many clients at once: how fast are answers, uploads and lists?

    python -m benchmarks.bench_load [--clients 8,16,32] [--seconds 8] [--json]

A real server on a loopback port has a dataset of 300,000 boxes. Clients in other
processes send requests without a pause, each over one connection: first all of them
answer boxes, then all store frames (a segmentation and 30 boxes), then all read pages
of lists, then a third of them does each. A time is from a request to the end of its
response. Memory is the proportional set size (PSS) of the server and its children: idle
after the start, at its peak under load, and idle again.
"""

from __future__ import annotations

import json
import multiprocessing
import tempfile
import time
from collections import Counter
from collections.abc import Generator, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from http import HTTPStatus
from http.client import HTTPConnection
from itertools import chain, count, cycle, islice
from pathlib import Path
from urllib.parse import urlencode, urlsplit

import httpx

from benchmarks.measuring import (
    client_of,
    create_dataset,
    opened,
    parser_of,
    quantile,
    sampled,
    served,
    show,
    store_million,
)
from benchmarks.street import street
from tests.support.large_datasets import NAME
from tests.support.servers import RunningServer

UPLOADS = "uploads"
VERDICTS = ("keep", "reject", "unsure")
WORK = ("answers", "uploads", "lists")
PROCESSES = 2
BOXES_OF = {"answers": 400, "uploads": 0, "lists": 0}
"""How many boxes each client answers; they are unanswered."""
IDLE_S = 15.0
LISTS = (
    {"sort": "doubt", "limit": "50"},
    {"sort": "doubt", "verdict": "rejected", "limit": "50"},
    {"sort": "id", "class": "walker", "limit": "100"},
    {"sort": "crowding", "limit": "50"},
)


Latencies = tuple[list[float], Counter[int]]
"""Seconds of each request of one kind, and how many were refused, by status."""
Requests = Generator[tuple[str, str, bytes | None, str], tuple[int, bytes], None]
"""Method, path, body and media type of requests without end; for each, the status and
the body of its response are sent in."""


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--clients", default="8,16,32")
    parser.add_argument("--seconds", type=float, default=8)
    parser.add_argument("--boxes", type=int, default=300_000)
    options = parser.parse_args()
    counts = [int(each) for each in options.clients.split(",")]
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        with opened(data) as context:
            store_million(context, options.boxes)
        with served(data) as server:
            figures = dict(measured(server, counts, options.seconds))
    show(figures, as_json=options.json)


def measured(
    server: RunningServer, counts: list[int], seconds: float
) -> Iterator[tuple[str, float]]:
    """Each figure with its name."""
    boxes = iter(box_ids(server, 2 * sum(counts) * BOXES_OF["answers"]))
    create_dataset(server, UPLOADS)
    time.sleep(IDLE_S)
    yield "memory when idle, before [MiB]", pss_mib(server.process.pid)
    with (
        sampled(lambda: pss_mib(server.process.pid), 0.5) as samples,
        ProcessPoolExecutor(
            PROCESSES, mp_context=multiprocessing.get_context("spawn")
        ) as pool,
    ):
        for clients in counts:
            for work in (*((each,) for each in WORK), WORK):
                every = [
                    LoadClient(
                        server.url,
                        server.token,
                        seconds,
                        kind,
                        f"{clients}-{len(work)}-{number}",
                        tuple(islice(boxes, BOXES_OF[kind])),
                    )
                    for number, kind in enumerate(islice(cycle(work), clients))
                ]
                shares = [every[process::PROCESSES] for process in range(PROCESSES)]
                done = list(chain.from_iterable(pool.map(run_clients, shares)))
                mixed = ", mixed" if len(work) > 1 else ""
                for kind in work:
                    name = f"{clients} clients{mixed}: {kind}"
                    replies = [reply for word, reply in done if word == kind]
                    times = list(chain.from_iterable(own for own, _ in replies))
                    refused = sum((statuses for _, statuses in replies), Counter())
                    yield f"{name} [1/s]", len(times) / seconds
                    for share in (0.5, 0.95, 0.99, 1.0):
                        word = "max" if share == 1 else f"p{100 * share:.0f}"
                        yield f"{name}, {word} [ms]", 1000 * quantile(times, share)
                    if refused:
                        yield f"{name}, refused", float(refused.total())
    yield "peak memory [MiB]", max(samples)
    time.sleep(IDLE_S)
    yield "memory when idle, afterwards [MiB]", pss_mib(server.process.pid)


def box_ids(server: RunningServer, count: int) -> list[int]:
    """The ids of `count` stored boxes."""
    ids: list[int] = []
    query = {"dataset": NAME, "sort": "id", "limit": "1000"}
    with client_of(server) as client:
        while len(ids) < count:
            page = client.get("/boxes", params=query).json()
            ids += [item["box_id"] for item in page["items"]]
            query["cursor"] = page["next_cursor"]
    return ids[:count]


@dataclass(frozen=True)
class LoadClient:
    """A client with one connection, which sends requests without a pause."""

    url: str
    token: str
    seconds: float
    work: str
    name: str
    boxes: tuple[int, ...]

    def run(self, frame: httpx.Request) -> tuple[str, Latencies]:
        """Do this client's work; uploads have the body of `frame`."""
        requests = {
            "answers": self.answers,
            "uploads": lambda: self.uploads(frame),
            "lists": self.lists,
        }[self.work]()
        connection = HTTPConnection(urlsplit(self.url).netloc, timeout=120)
        times, refused = [], Counter[int]()
        method, path, body, media_type = next(requests)
        until = time.monotonic() + self.seconds
        while time.monotonic() < until:
            headers = {"Authorization": f"Bearer {self.token}"}
            if media_type:
                headers["Content-Type"] = media_type
            begun = time.perf_counter()
            connection.request(method, f"/api/v1{path}", body, headers)
            response = connection.getresponse()
            content = response.read()
            times.append(time.perf_counter() - begun)
            if response.status >= 300:
                refused[response.status] += 1
            method, path, body, media_type = requests.send((response.status, content))
        return self.work, (times, refused)

    def answers(self) -> Requests:
        """Answer one box after the other, round after round."""
        seen = dict.fromkeys(self.boxes, 0)
        for box, verdict in zip(cycle(self.boxes), cycle(VERDICTS), strict=False):
            body = json.dumps({"verdict": verdict, "seen_revision": seen[box]})
            path = f"/boxes/{box}/reviews"
            status, _ = yield "POST", path, body.encode(), "application/json"
            seen[box] += status == HTTPStatus.CREATED

    def uploads(self, frame: httpx.Request) -> Requests:
        """Store one new frame after the other, all with this body."""
        for number in count():
            path = f"/datasets/{UPLOADS}/frames/{self.name}/{number}"
            yield "PUT", path, frame.content, frame.headers["Content-Type"]

    def lists(self) -> Requests:
        """Read ten pages of one list after the other."""
        for query in cycle(LISTS):
            parameters = {"dataset": NAME, **query}
            for _ in range(10):
                _, body = yield "GET", f"/boxes?{urlencode(parameters)}", None, ""
                parameters["cursor"] = json.loads(body)["next_cursor"]


def run_clients(clients: list[LoadClient]) -> list[tuple[str, Latencies]]:
    """Run the clients of this process, each in a thread; the latencies of each."""
    # Drawn before the time begins: otherwise the first uploads would wait for it.
    scene = street()
    files = {"segmentation": scene.png}
    form = {"annotation": json.dumps(scene.annotation)}
    frame = httpx.Request("PUT", "http://frame", files=files, data=form)
    frame.read()
    with ThreadPoolExecutor(len(clients)) as pool:
        return list(pool.map(lambda client: client.run(frame), clients))


def pss_mib(pid: int) -> float:
    """The memory of a process and of all below it, shared pages in proportion."""
    total = 0
    for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
        if line.startswith("Pss:"):
            total = int(line.split()[1])
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return total / 1024 + sum(pss_mib(int(child)) for child in children)


if __name__ == "__main__":
    main()
