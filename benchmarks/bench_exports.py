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
from typing import Any

import numpy as np
from numpy.random import Generator
from sqlalchemy import insert, select
from sqlalchemy.orm import Session

from app.db.base import utc_now
from app.db.evidence_record import pack_numbers
from app.db.tables import Box, Dataset, Decision, Frame, FrameEvidence
from app.repositories.datasets import DatasetRepository
from app.repositories.frames import FrameRepository
from app.repositories.runs import ExportRepository
from app.repositories.tallies import TallyRepository
from app.services.context import ServiceContext
from app.services.datasets import NewDataset, create_dataset
from app.services.exports import ExportRequest, request_export
from app.services.measuring import DatasetReading
from app.services.statistics import tallies_of
from benchmarks.bench_runs import opened
from benchmarks.million import numbers
from filter_core.config import FilterConfig
from filter_core.decide import decide
from filter_core.types import Decisions, Evidence

SIZES = (1_000, 10_000)
BOXES = 30
PORTION = 500
MIB = 1024
RECTANGLE = [10.0, 10.0, 60.0, 50.0]


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
            print(f"{name:58} {value:10.3f}")
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
        "peak of ten times as many frames / peak": many["peak"] / few["peak"],
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
    rng = np.random.default_rng(20240402)
    with context.database.write() as session:
        reading = DatasetReading("exported")
        wanted = NewDataset(reading, "", None, FilterConfig(), "benchmark")
        dataset = create_dataset(session, wanted)
        for start in range(0, frames, PORTION):
            _store(session, dataset, min(PORTION, frames - start), rng)
        return dataset.id


def _store(session: Session, dataset: Dataset, count: int, rng: Generator) -> None:
    classes = DatasetRepository(session).classes(dataset.id)
    first_frame, first_box = FrameRepository(session).take_ids(count, count * BOXES)
    evidence = numbers(count * BOXES, tuple(classes), rng)
    decisions = decide(evidence, FilterConfig())
    ids, names = list(classes.values()), list(classes)
    for index in range(count):
        rows = np.arange(index * BOXES, (index + 1) * BOXES)
        frame_id, box_id = first_frame + index, first_box + int(rows[0])
        of_frame = evidence.take(rows)
        labels = [names[at] for at in of_frame.class_index.tolist()]
        session.execute(insert(Frame), [_frame(dataset, frame_id, box_id, labels)])
        packed = pack_numbers(of_frame, ids)
        session.execute(insert(FrameEvidence), [_evidence(dataset, frame_id, packed)])
    class_ids = [ids[at] for at in evidence.class_index.tolist()]
    frame_ids = [first_frame + row // BOXES for row in range(count * BOXES)]
    boxes = [
        {
            "id": first_box + row,
            "frame_id": of,
            "class_id": named,
            "source_id": str(row),
        }
        for row, (of, named) in enumerate(zip(frame_ids, class_ids, strict=True))
    ]
    session.execute(insert(Box), boxes)
    current = _current(dataset, boxes, evidence, decisions)
    session.execute(insert(Decision), current)
    alike = ((r["class_id"], r["reason"], r["toss_up"], None) for r in current)
    TallyRepository(session).add(dataset.id, tallies_of(alike))


def _frame(
    dataset: Dataset, frame_id: int, first_box: int, labels: list[str]
) -> dict[str, Any]:
    boxes = [
        {"id": str(at), "class": name, "xyxy": RECTANGLE}
        for at, name in enumerate(labels)
    ]
    return {
        "id": frame_id,
        "dataset_id": dataset.id,
        "key": f"{frame_id:08d}",
        "revision": 1,
        "content_digest": f"{frame_id:064d}",
        "config_id": dataset.active_config_id,
        "run_id": dataset.active_run_id,
        "first_box_id": first_box,
        "box_count": BOXES,
        "width": 1280,
        "height": 720,
        "annotation": {"boxes": boxes},
        "created_by": "benchmark",
        "created_at": utc_now(),
    }


def _evidence(dataset: Dataset, frame_id: int, packed: bytes) -> dict[str, Any]:
    return {
        "frame_id": frame_id,
        "measurement_id": dataset.active_measurement_id,
        "numbers": packed,
        "tag_counts": b"",
        "geometry": b"",
        "segmentation": {"palette": "carla-0.9.14", "lossy": False},
        "lossy": False,
    }


def _current(
    dataset: Dataset,
    boxes: list[dict[str, Any]],
    evidence: Evidence,
    decisions: Decisions,
) -> list[dict[str, Any]]:
    return [
        {
            "box_id": box["id"],
            "dataset_id": dataset.id,
            "frame_id": box["frame_id"],
            "class_id": box["class_id"],
            "match_percent": float(evidence.match_percent[row]),
            "crowding": float(evidence.crowding[row]),
            "distance": float(evidence.distance[row]),
            "reason": int(decisions.reason[row]),
            "large": bool(decisions.large[row]),
            "toss_up": bool(decisions.toss_up[row]),
            "revision": 0,
        }
        for row, box in enumerate(boxes)
    ]


if __name__ == "__main__":
    sys.exit(main())
