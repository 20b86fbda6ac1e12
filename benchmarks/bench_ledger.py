"""Does the memory of the process that drives a job grow with the job's chunks?

    python -m benchmarks.bench_ledger [--few 10000] [--many 1000000] [--json]

The driver and the ledger are real, a SQLite database on the disk; the chunks are not:
whatever is submitted is done at once. Beside it the same number of tasks is submitted
to a pool at once, as one would without a window. Each is a process of its own, and the
figure is the most memory that it ever had. SQLite may keep 8 MiB of the ledger in
memory instead of the service's 256, or that would be what grows.
"""

from __future__ import annotations

import argparse
import json
import sqlite3
import subprocess
import sys
import tempfile
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from sqlalchemy import event
from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.datasets.service import NewDataset, create_dataset
from app.db.tables import Run
from app.engine import Job, LocalEngine
from app.engine.chunk import DONE, ChunkWork
from app.jobs.chunks import PlannedChunk
from app.jobs.driver import drive_job
from app.jobs.kind import Task, register
from app.jobs.queries import job_of
from app.measuring.plan import DatasetReading
from app.process.lifespan import running
from app.runs.service import RunJobs
from app.settings import Settings
from benchmarks.bench_batch import peak_mib
from filter_core.config.filter import FilterConfig

MOST_IN_FLIGHT = 256
CACHE_KIB = 8 * 1024
ASKED = 1.1


class Chunks(RunJobs):
    """A run of so many chunks of one frame each; its final step is nothing."""

    def __init__(self, chunks: int) -> None:
        self._chunks = chunks

    def begin(self, session: Session, row: Run) -> None:
        """There are no frames to count."""

    def plan(
        self, session: Session, row: Run, *, after: int, most: int, frames: int
    ) -> list[PlannedChunk]:
        """The next chunks."""
        end = min(self._chunks, after + most)
        return [PlannedChunk(number, number, 1) for number in range(after + 1, end + 1)]

    def finish(self, task: Task[Run]) -> None:
        """End it."""
        with task.context.database.write() as session:
            task.end_job(session)


class Instant(LocalEngine):
    """Has done whatever it is asked for."""

    @property
    def window(self) -> int:
        """As many as a cluster may have in flight."""
        return MOST_IN_FLIGHT

    def start_chunk(self, here: ChunkWork, job: Job, number: int) -> Future[str]:
        """Nothing is worked on; `here` is not used."""
        future: Future[str] = Future()
        future.set_result(DONE)
        return future


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--few", type=int, default=10_000)
    parser.add_argument("--many", type=int, default=1_000_000)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--alone", choices=("driver", "at once"), help="one process")
    options = parser.parse_args()
    if options.alone:
        print(json.dumps(measured(options.alone, options.many)))
        return 0
    figures: dict[str, float] = {}
    for way in ("driver", "at once"):
        for chunks in (options.few, options.many):
            seconds, base, peak = in_a_process(way, chunks)
            figures[f"{way}, {chunks} chunks: took [s]"] = seconds
            figures[f"{way}, {chunks} chunks: peak [MiB]"] = peak
            figures[f"{way}, {chunks} chunks: of these before [MiB]"] = base
    few, many = (f"driver, {n} chunks: peak [MiB]" for n in (options.few, options.many))
    figures["the driver's second peak / the first: measured"] = (
        figures[many] / figures[few]
    )
    figures["the driver's second peak / the first: asked, at most"] = ASKED
    if options.json:
        print(json.dumps(figures, indent=1))
    else:
        for name, value in figures.items():
            print(f"{name:58} {value:10.2f}")
    return 0


def in_a_process(way: str, chunks: int) -> tuple[float, float, float]:
    """Seconds, and memory before and at most, of a process that does nothing else."""
    command = [sys.executable, "-m", "benchmarks.bench_ledger", "--alone", way]
    answer = subprocess.run(
        [*command, "--many", str(chunks)], check=True, stdout=subprocess.PIPE, text=True
    )
    seconds, base, peak = json.loads(answer.stdout)
    return seconds, base, peak


def measured(way: str, chunks: int) -> tuple[float, float, float]:
    """Seconds, and MiB before and at most."""
    with (
        tempfile.TemporaryDirectory() as folder,
        running(Settings(data=Path(folder) / "data")) as context,
    ):
        keep_little(context)
        base, begun = peak_mib("self"), time.perf_counter()
        if way == "driver":
            drive(context, chunks)
        else:
            submit_at_once(chunks)
        return time.perf_counter() - begun, base, peak_mib("self")


def keep_little(context: ServiceContext) -> None:
    """Let SQLite hold few pages of the database."""
    engine = context.database.engine
    engine.dispose()

    @event.listens_for(engine, "connect")
    def _limit(connection: sqlite3.Connection, _record: object) -> None:
        connection.execute(f"PRAGMA cache_size=-{CACHE_KIB}").close()


def drive(context: ServiceContext, chunks: int) -> None:
    """Drive a job of so many chunks to its end."""

    context = ServiceContext(
        settings=context.settings,
        database=context.database,
        storage=context.storage,
        engine=Instant(1),
        pixels=context.pixels,
        drawers=context.drawers,
        folders=context.folders,
    )
    config = FilterConfig()
    wanted = NewDataset(DatasetReading("chunks"), "", None, config, "benchmark")
    register(Chunks(chunks))
    with context.database.write() as session:
        dataset = create_dataset(session, wanted)
        run = Run(
            dataset_id=dataset.id,
            config_id=dataset.active_config_id,
            kind="decide",
            total=chunks,
            counts={},
            created_by="benchmark",
        )
        session.add(run)
        session.flush()
        job = job_of(run)
    drive_job(context, job)


def submit_at_once(chunks: int) -> None:
    """What a driver without a window would do."""
    with ThreadPoolExecutor(1) as pool:
        for future in [pool.submit(int, number) for number in range(chunks)]:
            future.result()


if __name__ == "__main__":
    sys.exit(main())
