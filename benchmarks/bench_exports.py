"""Writing the labels of 300,000 boxes: how long, and with how much memory.

    python -m benchmarks.bench_exports [--json]

Each size is exported in a process of its own, whose peak of memory is then its own. The
datasets are made as rows, once, and kept in ``benchmarks/.data``.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import threading
import time
from pathlib import Path

from sqlalchemy import select

from app.db.tables import Dataset
from app.repositories.datasets import DatasetRepository
from app.repositories.runs import ExportRepository
from app.services.context import ServiceContext
from app.services.exports import ExportRequest, request_export
from benchmarks.bench_runs import opened
from benchmarks.million import Wanted, make

SIZES = (1_000, 10_000)
BOXES = 30
MIB = 1024
MOST_MEMORY = 1.1


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--data", type=Path, default=Path("benchmarks/.data"))
    parser.add_argument("--frames", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.frames:
        print(json.dumps(exported(options.data, options.frames)))
        return 0
    figures = summary(*(in_a_process(options.data, size) for size in SIZES))
    if options.json:
        print(json.dumps(figures, indent=1))
    else:
        for name, value in figures.items():
            print(f"{name:60} {value:10.3f}")
    return 0


def in_a_process(data: Path, frames: int) -> dict[str, float]:
    command = [sys.executable, "-m", "benchmarks.bench_exports"]
    command += ["--data", str(data), "--frames", str(frames)]
    # Once to make the rows, once to measure: making them takes memory as well.
    for _ in range(2):
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    found: dict[str, float] = json.loads(done.stdout)
    return found


def summary(few: dict[str, float], many: dict[str, float]) -> dict[str, float]:
    return {
        f"YOLO export of {SIZES[0]:,} frames [s]": few["seconds"],
        f"YOLO export of {SIZES[1]:,} frames [s]": many["seconds"],
        f"processor time of it, {SIZES[1]:,} frames [s]": many["processor"],
        f"peak memory, {SIZES[0]:,} frames [MiB]": few["peak"],
        f"peak memory, {SIZES[1]:,} frames [MiB]": many["peak"],
        "peak of ten times as many frames / peak: measured": many["peak"] / few["peak"],
        "peak of ten times as many frames / peak: asked, at most": MOST_MEMORY,
    }


def exported(data: Path, frames: int) -> dict[str, float]:
    """Seconds of one export, and the peak of this process's memory in MiB."""
    context = opened(data / f"exports-{frames}")
    try:
        dataset_id = filled(context, frames)
        over = threading.Event()
        begun, worked = time.perf_counter(), time.process_time()
        with context.database.write() as session:
            dataset = DatasetRepository(session).with_id(dataset_id)
            wanted = ExportRequest("yolo", {"images": "none"}, "benchmark")
            export_id = request_export(context, session, dataset, wanted).id
        # Jobs are done one after the other: this one when the export is over.
        context.engine.submit(over.set)
        over.wait()
        seconds = time.perf_counter() - begun
        processor = time.process_time() - worked
        with context.database.read() as session:
            export = ExportRepository(session).with_id(export_id)
            assert (export.state, export.done) == ("done", frames), export.error
    finally:
        context.close()
        context.database.close()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MIB
    return {"seconds": seconds, "processor": processor, "peak": peak}


def filled(context: ServiceContext, frames: int) -> int:
    """The dataset, made if it is not there; its id."""
    with context.database.read() as session:
        known = session.scalar(select(Dataset.id).where(Dataset.name == "exported"))
    if known is not None:
        return known
    wanted = Wanted("exported", frames, BOXES, annotated=True, seed=20240402)
    return make(context, wanted, lambda _: None)


if __name__ == "__main__":
    sys.exit(main())
