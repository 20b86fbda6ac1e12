"""What does a run cost when a worker of a cluster measures it instead of the service?

    python -m benchmarks.bench_cluster [--frames 1600] [--rounds 4] [--json]

Two services have the same frames (`street`'s segmentation and 30 boxes). One measures
them in its own threads; the other sends chunks over mutual TLS to a worker with as many
threads. Alternately, each measures all frames under settings that none was measured
with before. The figures are the processor time of all processes involved: service,
scheduler and worker.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from os import cpu_count
from pathlib import Path

from benchmarks.bench_batch import Scene, send
from benchmarks.measuring import cpu_seconds, create_dataset, parser_of, served, show
from benchmarks.street import street
from tests.support.api import Api
from tests.support.cluster import cluster
from tests.support.processes import children
from tests.support.servers import RunningServer
from tests.support.slow_datasets import OTHER_PIXELS

DATASET = "bench"
AIM_CPU_RATIO = 1.10
POLL_EVERY_S = 1.0


@dataclass(frozen=True)
class Service:
    """A service with the frames, and the processes that its runs keep busy."""

    server: RunningServer
    api: Api
    pids: Callable[[], list[int]]

    def cpu_of_run(self, config: object) -> float:
        """Processor seconds of one run over all frames."""
        pids = self.pids()
        before = sum(map(cpu_seconds, pids))
        run = self.api.post(f"/datasets/{DATASET}/runs", {"config": config}).json()
        while run["state"] in ("queued", "running"):
            # Polling more often would add to the measured time.
            time.sleep(POLL_EVERY_S)
            run = self.api.json(f"/runs/{run['id']}")
        assert run["state"] == "done", run
        return sum(map(cpu_seconds, pids)) - before


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--frames", type=int, default=1600)
    parser.add_argument("--rounds", type=int, default=4, choices=range(1, 7))
    options = parser.parse_args()
    with (
        tempfile.TemporaryDirectory() as folder,
        both_services(Path(folder)) as services,
    ):
        figures = compared(*services, options.frames, options.rounds)
    show(figures, as_json=options.json)


def compared(
    local: Service, spread: Service, frames: int, rounds: int
) -> dict[str, float]:
    """Processor time per frame of both, alternately."""
    frame = street()
    scene = Scene(frame.png, b"", frame.annotation)
    for service in (local, spread):
        create_dataset(service.server, DATASET)
        send(service.server, scene, frames, "all", DATASET)
    here, there = [], []
    for config in OTHER_PIXELS[: rounds + 1]:
        here.append(local.cpu_of_run(config) / frames)
        there.append(spread.cpu_of_run(config) / frames)
    # The first round warms up.
    here_s, there_s = statistics.median(here[1:]), statistics.median(there[1:])
    threads = cpu_count() or 1
    return {
        "frames of a chunk": max(20, min(500, frames // 4)),
        "threads of the service, and of the worker": threads,
        "in the service's own threads [ms per frame]": 1000 * here_s,
        "by a worker over mutual TLS [ms per frame]": 1000 * there_s,
        "the second / the first: measured": there_s / here_s,
        "the second / the first: aim, at most": AIM_CPU_RATIO,
    }


@contextmanager
def both_services(folder: Path) -> Iterator[tuple[Service, Service]]:
    """A service without a cluster, and one with a scheduler and a worker."""
    quiet = {"UNGHOST_LOG_LEVEL": "warning"}
    with cluster(folder, anew=True) as made, served() as alone:
        own = Api.at(alone.url, alone.headers)
        scheduler = made.scheduler()
        with own.http, made.server(**quiet) as (server, api):
            worker = made.worker(UNGHOST_WORKERS=str(cpu_count() or 1))

            def involved() -> list[int]:
                parent = worker.process.pid
                nodes = [server.process.pid, scheduler.process.pid, parent]
                return [*nodes, *children(parent)]

            local = Service(alone, own, lambda: [alone.process.pid])
            yield local, Service(server, api, involved)


if __name__ == "__main__":
    main()
