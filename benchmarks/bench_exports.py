"""How long does writing the labels of 300,000 boxes take, and does memory grow?

    python -m benchmarks.bench_exports [--json]
    python -m benchmarks.bench_exports --frames 1000 --format coco

The second makes one export of so many frames in this process and prints its figures; it
serves to compare two commits alternately.

The export is made in a process of its own, whose memory is sampled fifty times a
second. The figures are its peak in the first tenth of the time, which is about a tenth
of the frames, and its peak overall. (An export of few frames may end before the second
sample: then both are the memory at its start.) The dataset is made as rows, once, and
kept in ``benchmarks/.data``.
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

from app.catalog.datasets import DatasetRepository
from app.context import ServiceContext
from app.db.tables import Dataset, Export
from app.exports.service import ExportRequest, request_export
from app.jobs.queries import job_with_id
from filter_core.formats.registry import EXPORT_FORMATS, FORMATS
from tests.support.large_datasets import DatasetSpec, make_dataset, open_context
from tests.support.waiting import until

FRAMES, BOXES = 10_000, 30
SAMPLE_EVERY_S = 0.02
AIM_MEMORY_RATIO = 1.1


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--data", type=Path, default=Path("benchmarks/.data"))
    parser.add_argument("--frames", type=int)
    parser.add_argument("--format", default="yolo", choices=EXPORT_FORMATS)
    options = parser.parse_args()
    if options.frames:
        print(json.dumps(exported(options.data, options.frames, options.format)))
        return 0
    figures = summary(in_a_process(options.data, FRAMES))
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


def summary(found: dict[str, float]) -> dict[str, float]:
    return {
        f"YOLO export of {FRAMES:,} frames [s]": found["seconds"],
        "processor time of it [s]": found["processor"],
        "memory after a tenth of it [MiB]": found["early"],
        "memory at most [MiB]": found["peak"],
        "the second / the first: measured": found["peak"] / found["early"],
        "the second / the first: aim, at most": AIM_MEMORY_RATIO,
    }


class Memory:
    """Samples the memory of this process: at once, then in a thread."""

    def __init__(self) -> None:
        self._mib = [_memory_mib()]
        self._over = threading.Event()
        self._sampler = threading.Thread(target=self._sample)

    def __enter__(self) -> Memory:
        self._sampler.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self._sampler.join()

    def _sample(self) -> None:
        while not self._over.wait(SAMPLE_EVERY_S):
            self._mib.append(_memory_mib())

    @property
    def early(self) -> float:
        """The maximum of the first tenth of the samples, at least of the first one."""
        return max(self._mib[: max(1, len(self._mib) // 10)])

    @property
    def peak(self) -> float:
        """The maximum."""
        return max(self._mib)


def _memory_mib() -> float:
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    return pages * resource.getpagesize() / (1 << 20)


def _is_over(context: ServiceContext, export_id: int) -> bool:
    with context.database.read() as session:
        return job_with_id(session, Export, export_id).state in ("done", "failed")


def exported(data: Path, frames: int, form: str) -> dict[str, float]:
    """Seconds of one export, and this process's memory in MiB, early and at most."""
    context = open_context(data / f"exports-{frames}")
    try:
        dataset_id = filled(context, frames)
        begun, worked = time.perf_counter(), time.process_time()
        with Memory() as memory:
            with context.database.write() as session:
                dataset = DatasetRepository(session).with_id(dataset_id)
                labels = "images" in FORMATS[form].options
                options = {"images": "none"} if labels else {}
                request = ExportRequest(form, options, "benchmark")
                export_id = request_export(context, session, dataset, request).id
            until(lambda: _is_over(context, export_id), every_s=0.01)
        seconds = time.perf_counter() - begun
        processor = time.process_time() - worked
        with context.database.read() as session:
            export = job_with_id(session, Export, export_id)
            assert (export.state, export.done) == ("done", frames), export.error
    finally:
        context.close()
        context.database.close()
    return {
        "seconds": seconds,
        "processor": processor,
        "early": memory.early,
        "peak": memory.peak,
    }


def filled(context: ServiceContext, frames: int) -> int:
    """The dataset, made if it does not exist; its id."""
    with context.database.read() as session:
        known = session.scalar(select(Dataset.id).where(Dataset.name == "exported"))
    if known is not None:
        return known
    spec = DatasetSpec("exported", frames, BOXES, annotated=True, seed=20240402)
    return make_dataset(context, spec, lambda _: None)


if __name__ == "__main__":
    sys.exit(main())
