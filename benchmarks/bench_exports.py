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

import json
import resource
import time
from pathlib import Path

from sqlalchemy import select

from app.catalog.datasets import DatasetRepository
from app.db.tables import Dataset, Export
from app.exports.service import request_export
from app.jobs.queries import job_with_id
from benchmarks.measuring import (
    AIM_MEMORY_RATIO,
    DATA,
    MIB,
    in_a_process,
    opened,
    parser_of,
    progress,
    sampled,
    show,
)
from filter_core.formats.registry import EXPORT_FORMATS, FORMATS
from tests.support.large_datasets import DatasetSpec, make_dataset
from unghost.wire.runs import ExportIn

FRAMES, BOXES = 10_000, 30


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--frames", type=int)
    parser.add_argument("--format", default="yolo", choices=EXPORT_FORMATS)
    options = parser.parse_args()
    if options.frames:
        print(json.dumps(exported(options.data, options.frames, options.format)))
        return
    # Once to make the rows, once to measure: making them takes memory as well.
    for _ in range(2):
        words = ("--data", options.data, "--frames", FRAMES)
        export = in_a_process("benchmarks.bench_exports", *words)
    figures = {
        f"YOLO export of {FRAMES:,} frames [s]": export["seconds"],
        "processor time of it [s]": export["processor"],
        "memory after a tenth of it [MiB]": export["early"],
        "memory at most [MiB]": export["peak"],
        "the second / the first: measured": export["peak"] / export["early"],
        "the second / the first: aim, at most": AIM_MEMORY_RATIO,
    }
    show(figures, as_json=options.json)


def resident_mib() -> float:
    """The memory of this process now."""
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    return pages * resource.getpagesize() / MIB


def exported(data: Path, frames: int, form: str) -> dict[str, float]:
    """Seconds of one export, and this process's memory in MiB, early and at most."""
    with opened(data / f"exports-{frames}") as context:
        with context.database.read() as session:
            dataset_id = session.scalar(
                select(Dataset.id).where(Dataset.name == "exported")
            )
        if dataset_id is None:
            spec = DatasetSpec("exported", frames, BOXES, annotated=True, seed=20240402)
            dataset_id = make_dataset(context, spec, progress)
        begun, worked = time.perf_counter(), time.process_time()
        with sampled(resident_mib, 1 / 50) as samples:
            with context.database.write() as session:
                dataset = DatasetRepository(session).with_id(dataset_id)
                labels = "images" in FORMATS[form].options
                options = {"images": "none"} if labels else {}
                wanted = {"format": form, "options": options}
                export_id = request_export(
                    context, session, dataset, ExportIn.model_validate(wanted), "ada"
                ).id
            while True:
                with context.database.read() as session:
                    export = job_with_id(session, Export, export_id)
                if export.state in ("done", "failed"):
                    break
                time.sleep(0.01)
        seconds = time.perf_counter() - begun
        processor = time.process_time() - worked
        assert (export.state, export.done) == ("done", frames), export.error
    return {
        "seconds": seconds,
        "processor": processor,
        "early": max(samples[: max(1, len(samples) // 10)]),
        "peak": max(samples),
    }


if __name__ == "__main__":
    main()
