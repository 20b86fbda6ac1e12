"""Does the memory of the process that drives a job grow with the job's chunks?

    python -m benchmarks.bench_chunks [--few 10000] [--many 1000000] [--json]

The driver and its table of chunks are real, in a SQLite database on the disk; the work
is not: each chunk is done as soon as it is submitted. For comparison, the same number
of tasks is submitted to a pool without a limit of open ones. Each measurement has a
process of its own, and its figure is the peak memory. SQLite's cache is limited to 8
MiB instead of the service's 256, since otherwise the cache would be what grows.
"""

from __future__ import annotations

import json
import sqlite3
import tempfile
import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from sqlalchemy import event
from sqlalchemy.orm import Session

from app.context import ServiceContext
from app.datasets.service import NewDataset, create_dataset
from app.db.tables import Run
from app.engine.chunk import DONE, ChunkWork, Job
from app.engine.local import LocalEngine
from app.jobs.chunks import PlannedChunk
from app.jobs.driver import drive_job
from app.jobs.kind import Task, register
from app.jobs.queries import job_of
from app.measuring.plan import DatasetReading
from app.process.lifespan import running
from app.runs.service import RunJobs
from app.settings import Settings
from benchmarks.measuring import (
    AIM_MEMORY_RATIO,
    in_a_process,
    parser_of,
    peak_mib,
    show,
)
from filter_core.config.filter import FilterConfig

MAX_IN_FLIGHT = 256
CACHE_KIB = 8 * 1024


class EmptyRunJobs(RunJobs):
    """A run with `chunks` chunks of one frame each, and nothing to do at its end."""

    def __init__(self, chunks: int) -> None:
        self._chunks = chunks

    def begin(self, session: Session, row: Run) -> None:
        """Do nothing: there are no frames to count."""

    def plan(
        self, session: Session, row: Run, *, after: int, most: int, frames: int
    ) -> list[PlannedChunk]:
        """The next chunks."""
        end = min(self._chunks, after + most)
        return [PlannedChunk(number, number, 1) for number in range(after + 1, end + 1)]

    def finish(self, task: Task[Run]) -> None:
        """End the job."""
        with task.context.database.write() as session:
            task.end_job(session)


class InstantEngine(LocalEngine):
    """An engine that reports each chunk as done without working on it."""

    @property
    def window(self) -> int:
        """As many open chunks as a cluster may have."""
        return MAX_IN_FLIGHT

    def start_chunk(self, here: ChunkWork, job: Job, number: int) -> Future[str]:
        """A chunk that is done already; `here` is not used."""
        future: Future[str] = Future()
        future.set_result(DONE)
        return future


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--few", type=int, default=10_000)
    parser.add_argument("--many", type=int, default=1_000_000)
    parser.add_argument("--alone", choices=("driver", "at once"), help="one process")
    options = parser.parse_args()
    if options.alone:
        print(json.dumps(measured(options.alone, options.many)))
        return
    figures: dict[str, float] = {}
    for way in ("driver", "at once"):
        for chunks in (options.few, options.many):
            words = ("--alone", way, "--many", chunks)
            for name, value in in_a_process("benchmarks.bench_chunks", *words).items():
                figures[f"{way}, {chunks} chunks: {name}"] = value
    few, many = (f"driver, {n} chunks: peak [MiB]" for n in (options.few, options.many))
    figures["the driver's second peak / the first: measured"] = (
        figures[many] / figures[few]
    )
    figures["the driver's second peak / the first: aim, at most"] = AIM_MEMORY_RATIO
    show(figures, as_json=options.json)


def measured(way: str, chunks: int) -> dict[str, float]:
    """The time, and the memory before it and at the peak."""
    with (
        tempfile.TemporaryDirectory() as folder,
        running(Settings(data=Path(folder) / "data")) as context,
    ):
        engine = context.database.engine
        engine.dispose()

        @event.listens_for(engine, "connect")
        def _limit_cache(connection: sqlite3.Connection, _record: object) -> None:
            connection.execute(f"PRAGMA cache_size=-{CACHE_KIB}").close()

        base, begun = peak_mib(), time.perf_counter()
        if way == "driver":
            drive(context, chunks)
        else:
            # All tasks are submitted at once, as a driver without a limit would.
            with ThreadPoolExecutor(1) as pool:
                for future in [pool.submit(int, number) for number in range(chunks)]:
                    future.result()
        taken = time.perf_counter() - begun
    return {"time [s]": taken, "peak [MiB]": peak_mib(), "before it [MiB]": base}


def drive(context: ServiceContext, chunks: int) -> None:
    """Drive a job with this number of chunks to its end."""
    context = replace(context, engine=InstantEngine(1))
    config = FilterConfig()
    new = NewDataset(DatasetReading("chunks"), "", None, config, "benchmark")
    register(EmptyRunJobs(chunks))
    with context.database.write() as session:
        dataset = create_dataset(session, new)
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


if __name__ == "__main__":
    main()
