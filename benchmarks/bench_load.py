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

import argparse
import http.client
import json
import multiprocessing
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import cycle, islice
from pathlib import Path
from threading import Event, Thread
from urllib.parse import urlencode, urlsplit

import httpx

from benchmarks.bench_runs import quantile
from benchmarks.street import street
from tests.support.large_datasets import NAME, fill, open_context
from tests.support.servers import RunningServer, running_server

UPLOADS = "uploads"
VERDICTS = ("keep", "reject", "unsure")
WORK = ("answers", "uploads", "lists")
PROCESSES = 2
BOXES_OF_A_CLIENT = 400
IDLE_S = 15.0
BOUNDARY = "frame"
JSON = {"Content-Type": "application/json"}
LISTS = (
    {"sort": "doubt", "limit": "50"},
    {"sort": "doubt", "verdict": "rejected", "limit": "50"},
    {"sort": "id", "class": "walker", "limit": "100"},
    {"sort": "crowding", "limit": "50"},
)


@dataclass(frozen=True)
class Share:
    """What the clients of one process do, and for how long."""

    url: str
    token: str
    work: tuple[str, ...]
    names: tuple[str, ...]
    boxes: tuple[tuple[int, ...], ...]
    seconds: float


@dataclass(frozen=True)
class Latencies:
    """Seconds of each request of one kind, and how many were refused, by status."""

    seconds: list[float]
    refused: Counter[int]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clients", default="8,16,32")
    parser.add_argument("--seconds", type=float, default=8)
    parser.add_argument("--boxes", type=int, default=300_000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    counts = [int(each) for each in options.clients.split(",")]
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        context = open_context(data)
        fill(context, options.boxes, lambda _: None)
        context.close()
        context.database.close()
        with running_server(
            data, {"UNGHOST_LOG_LEVEL": "warning"}, anew=True
        ) as server:
            figures = dict(measured(server, counts, options.seconds))
    if options.json:
        print(json.dumps(figures, indent=1))
    else:
        for name, value in figures.items():
            print(f"{name:52} {value:10.1f}")
    return 0


def measured(
    server: RunningServer, counts: list[int], seconds: float
) -> Iterator[tuple[str, float]]:
    """Each figure with its name."""
    boxes = iter(box_ids(server, 2 * sum(counts) * BOXES_OF_A_CLIENT))
    client = httpx.Client(base_url=server.url, headers=server.headers)
    client.post("/api/v1/datasets", json={"name": UPLOADS}).raise_for_status()
    time.sleep(IDLE_S)
    yield "memory when idle, before [MiB]", pss_mib(server.process.pid)
    with (
        WatchedMemory(server.process.pid) as samples,
        ProcessPoolExecutor(
            PROCESSES, mp_context=multiprocessing.get_context("spawn")
        ) as pool,
    ):
        for clients in counts:
            for work in (*((each,) for each in WORK), WORK):
                shares = list(shares_of(server, clients, work, boxes, seconds))
                latencies = together(pool.map(run_clients, shares))
                mixed = ", mixed" if len(work) > 1 else ""
                for kind in work:
                    name = f"{clients} clients{mixed}: {kind}"
                    yield from described(name, latencies[kind], seconds)
    yield "peak memory [MiB]", max(samples)
    time.sleep(IDLE_S)
    yield "memory when idle, afterwards [MiB]", pss_mib(server.process.pid)


def box_ids(server: RunningServer, count: int) -> list[int]:
    """The ids of `count` stored boxes."""
    found: list[int] = []
    query = {"dataset": NAME, "sort": "id", "limit": "1000"}
    with httpx.Client(base_url=server.url, headers=server.headers) as client:
        while len(found) < count:
            page = client.get("/api/v1/boxes", params=query).json()
            found += [item["box_id"] for item in page["items"]]
            query["cursor"] = page["next_cursor"]
    return found[:count]


def shares_of(
    server: RunningServer,
    clients: int,
    work: tuple[str, ...],
    boxes: Iterator[int],
    seconds: float,
) -> Iterator[Share]:
    """The clients of each process; their boxes are unanswered."""
    name = f"{clients}-{len(work)}"
    for process in range(PROCESSES):
        mine = range(process, clients, PROCESSES)
        kinds = tuple(work[number % len(work)] for number in mine)
        own = [BOXES_OF_A_CLIENT if kind == "answers" else 0 for kind in kinds]
        yield Share(
            server.url,
            server.token,
            kinds,
            tuple(f"{name}-{number}" for number in mine),
            tuple(tuple(islice(boxes, count)) for count in own),
            seconds,
        )


def run_clients(share: Share) -> list[tuple[str, Latencies]]:
    """Run the clients of this process, each in a thread; the latencies of each."""
    # Drawn before the time begins: otherwise the first uploads would wait for it.
    frame = frame_body()
    until = time.monotonic() + share.seconds

    def run_client(number: int) -> tuple[str, Latencies]:
        kind = share.work[number]
        client = LoadClient(share)
        requests: dict[str, Callable[[], Iterator[int]]] = {
            "answers": lambda: client.answers(share.boxes[number]),
            "uploads": lambda: client.uploads(share.names[number], frame),
            "lists": client.lists,
        }
        request = requests[kind]()
        times, refused = [], Counter[int]()
        while time.monotonic() < until:
            begun = time.perf_counter()
            status = next(request)
            times.append(time.perf_counter() - begun)
            if status >= 300:
                refused[status] += 1
        return kind, Latencies(times, refused)

    with ThreadPoolExecutor(len(share.work)) as pool:
        return list(pool.map(run_client, range(len(share.work))))


class LoadClient:
    """One connection; each method sends requests endlessly and yields their status."""

    def __init__(self, share: Share) -> None:
        self._connection = http.client.HTTPConnection(
            urlsplit(share.url).netloc, timeout=120
        )
        self._headers = {"Authorization": f"Bearer {share.token}"}

    def answers(self, boxes: tuple[int, ...]) -> Iterator[int]:
        """Answer one box after the other, round after round."""
        seen = dict.fromkeys(boxes, 0)
        for box, verdict in zip(cycle(boxes), cycle(VERDICTS), strict=False):
            body = json.dumps({"verdict": verdict, "seen_revision": seen[box]})
            path = f"/api/v1/boxes/{box}/reviews"
            status, _ = self._send("POST", path, body.encode(), JSON)
            if status == http.HTTPStatus.CREATED:
                seen[box] += 1
            yield status

    def uploads(self, name: str, body: bytes) -> Iterator[int]:
        """Store one new frame after the other, all with this body."""
        number = 0
        kind = {"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"}
        while True:
            path = f"/api/v1/datasets/{UPLOADS}/frames/{name}/{number}"
            yield self._send("PUT", path, body, kind)[0]
            number += 1

    def lists(self) -> Iterator[int]:
        """Read ten pages of one list after the other."""
        for query in cycle(LISTS):
            parameters = {"dataset": NAME, **query}
            for _ in range(10):
                status, body = self._send(
                    "GET", f"/api/v1/boxes?{urlencode(parameters)}"
                )
                yield status
                parameters["cursor"] = json.loads(body)["next_cursor"]

    def _send(
        self,
        method: str,
        path: str,
        body: bytes | None = None,
        headers: dict[str, str] | None = None,
    ) -> tuple[int, bytes]:
        self._connection.request(method, path, body, self._headers | (headers or {}))
        answer = self._connection.getresponse()
        return answer.status, answer.read()


def frame_body() -> bytes:
    """A segmentation and 30 boxes, as a form."""
    scene = street()
    boxes = [
        {"class": name, "xyxy": [round(value, 3) for value in xyxy]}
        for name, xyxy in zip(scene.classes, scene.xyxy.tolist(), strict=True)
    ]
    annotation = json.dumps({"carla_version": "0.9.15", "boxes": boxes}).encode()
    parts = (
        (b'name="annotation"', annotation),
        (b'name="segmentation"; filename="s.png"', scene.png),
    )
    line = f"--{BOUNDARY}".encode()
    return b"".join(
        line + b"\r\nContent-Disposition: form-data; " + name + b"\r\n\r\n" + content
        + b"\r\n"
        for name, content in parts
    ) + line + b"--\r\n"  # fmt: skip


def together(found: Iterator[list[tuple[str, Latencies]]]) -> dict[str, Latencies]:
    """The latencies of all processes, by kind of work."""
    latencies = {kind: Latencies([], Counter()) for kind in WORK}
    for kind, one in (each for process in found for each in process):
        latencies[kind].seconds.extend(one.seconds)
        latencies[kind].refused.update(one.refused)
    return latencies


def described(
    name: str, latencies: Latencies, seconds: float
) -> Iterator[tuple[str, float]]:
    yield f"{name} [1/s]", len(latencies.seconds) / seconds
    for share in (0.5, 0.95, 0.99, 1.0):
        word = "max" if share == 1 else f"p{100 * share:.0f}"
        yield f"{name}, {word} [ms]", 1000 * quantile(latencies.seconds, share)
    if latencies.refused:
        yield f"{name}, refused", float(latencies.refused.total())


class WatchedMemory:
    """Samples the memory of a process twice a second, until the block ends."""

    def __init__(self, pid: int) -> None:
        self._pid, self._over, self._samples = pid, Event(), [0.0]
        self._thread = Thread(target=self._watch)

    def __enter__(self) -> list[float]:
        self._thread.start()
        return self._samples

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._over.wait(0.5):
            self._samples.append(pss_mib(self._pid))


def pss_mib(pid: int) -> float:
    """The memory of a process and of all below it, shared pages in proportion."""
    total = 0
    for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines():
        if line.startswith("Pss:"):
            total = int(line.split()[1])
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return total / 1024 + sum(pss_mib(int(child)) for child in children)


if __name__ == "__main__":
    sys.exit(main())
