"""How fast are runs, previews and lists with a million stored boxes?

    python -m benchmarks.bench_runs [--boxes 1000000] [--json]

The dataset is made once and kept in ``benchmarks/.data``.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from sqlalchemy.orm import Session

from app.boxes.filter import to_filter
from app.boxes.queries import PageRequest
from app.boxes.reader import DecisionReader, list_boxes
from app.catalog.datasets import DatasetRepository
from app.context import ServiceContext
from app.datasets.service import statistics as dataset_statistics
from app.db.tables import Dataset, Run
from app.measuring.columns import ColumnCache
from app.memory import settle
from app.runs.flips import PreviewLimits, preview
from app.runs.service import RunRequest, request_run
from filter_core.config.filter import FilterConfig
from tests.support.large_datasets import NAME, fill, open_context
from unghost.wire.boxes import BoxSelection

PAGES = 60
ENDED = ("done", "failed", "cancelled")
REPEATS = 3


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--boxes", type=int, default=1_000_000)
    parser.add_argument("--data", type=Path, default=Path("benchmarks/.data"))
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    context = open_context(options.data)
    try:
        prepare(context, options.boxes)
        settle()
        figures = {**runs(context), **previews(context), **lists(context)}
    finally:
        context.close()
        context.database.close()
    if options.json:
        print(json.dumps(figures, indent=1))
    else:
        for name, value in figures.items():
            print(f"{name:58} {value:10.3f}")
    return 0


def prepare(context: ServiceContext, boxes: int) -> None:
    with context.database.read() as session:
        known = DatasetRepository(session).page(after="", limit=10)
    if any(one.name == NAME for one in known):
        return

    def shown(done: int) -> None:
        sys.stderr.write(f"\rstoring {done:,} of {boxes:,} boxes")

    fill(context, boxes, shown)
    sys.stderr.write("\n")


def decided(context: ServiceContext, config: FilterConfig) -> tuple[float, int]:
    """Seconds from the request to the durable end of a run, and how many flipped."""
    begun = time.perf_counter()
    with context.database.write() as session:
        dataset = DatasetRepository(session).named(NAME)
        request = RunRequest(config, "benchmark", activate=True)
        run_id = request_run(context, session, dataset, request).id
    while True:
        with context.database.read() as session:
            run = session.get(Run, run_id)
            assert run is not None
            if run.state in ENDED:
                took = time.perf_counter() - begun
                assert run.state == "done", run.error
                return took, run.changed
        time.sleep(0.002)


def runs(context: ServiceContext) -> dict[str, float]:
    cold, _ = decided(context, FilterConfig(threshold_small_box=10))
    few, all_ = [], []
    for _ in range(REPEATS):
        seconds, few_changed = decided(context, small_flip())
        few.append(seconds)
        decided(context, FilterConfig())
    for _ in range(REPEATS):
        seconds, all_changed = decided(context, everything_flips())
        all_.append(seconds)
        seconds, _ = decided(context, FilterConfig())
        all_.append(seconds)
    return {
        "run from cold, nothing flips [s]": cold,
        "boxes that flip in the small run": float(few_changed),
        "run with the small flip, median [s]": statistics.median(few),
        "boxes that flip in the large run": float(all_changed),
        "run with the large flip, median [s]": statistics.median(all_),
    }


def small_flip() -> FilterConfig:
    return FilterConfig(threshold_small_box=4.1)


def everything_flips() -> FilterConfig:
    # Every box becomes out of range: the reason of each one changes.
    return FilterConfig(min_distance=1000)


def previews(context: ServiceContext) -> dict[str, float]:
    config = FilterConfig(threshold_small_box=12)
    with context.database.read() as session:
        dataset = DatasetRepository(session).named(NAME)
        limits = PreviewLimits(100, 50)
        preview(context, session, dataset, config, limits)
        measurement = dataset.active_measurement_id or 0
        held = context.one(ColumnCache).load(session, dataset.id, measurement)
        took = median(lambda: preview(context, session, dataset, config, limits))
    numbers = held.evidence
    columns = [getattr(numbers, name) for name in READ_BY_A_DECISION]

    def one_pass() -> list[int]:
        return [int(np.count_nonzero(column > 1)) for column in columns]

    reference = median(one_pass)
    return {
        "preview with counts, histograms and flips [ms]": 1000 * took,
        "one numpy pass over the same columns [ms]": 1000 * reference,
        "preview / one pass": took / reference,
    }


def median(work: Callable[[], object], repeats: int = 9) -> float:
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        work()
        times.append(time.perf_counter() - begun)
    return statistics.median(times)


READ_BY_A_DECISION = (
    "class_index",
    "state",
    "accept_mask",
    "measured",
    "box_pixels",
    "matched_pixels",
    "match_percent",
    "area_percent",
    "distance",
)

QUERIES: dict[str, tuple[BoxSelection, str]] = {
    "verdict=rejected by id": (BoxSelection(verdict="rejected"), "id"),
    "verdict=kept by id": (BoxSelection(verdict="kept"), "id"),
    "reason=below_threshold by id": (BoxSelection(reason="below_threshold"), "id"),
    "class=van by id": (BoxSelection(class_name="van"), "id"),
    "doubt": (BoxSelection(), "doubt"),
    "doubt, verdict=rejected": (BoxSelection(verdict="rejected"), "doubt"),
    "doubt, undecided walkers": (
        BoxSelection(review="undecided", class_name="walker"),
        "doubt",
    ),
    "match_percent": (BoxSelection(), "match_percent"),
    "crowding": (BoxSelection(), "crowding"),
}


def lists(context: ServiceContext) -> dict[str, float]:
    figures = {}
    with context.database.read() as session:
        dataset = DatasetRepository(session).named(NAME)
        for name, (selection, sort) in QUERIES.items():
            times = paged(session, dataset, selection, sort)
            figures[f"list {name}, p95 [ms]"] = 1000 * quantile(times, 0.95)
        stats = [
            timed(lambda: dataset_statistics(session, dataset)) for _ in range(PAGES)
        ]
        figures["stats, p95 [ms]"] = 1000 * quantile(stats, 0.95)
    return figures


def paged(
    session: Session, dataset: Dataset, selection: BoxSelection, sort: str
) -> list[float]:
    boxes = to_filter(session, dataset, selection)
    times, cursor = [], ""
    for _ in range(PAGES):
        begun = time.perf_counter()
        page = PageRequest(sort, cursor, 100)
        reader = DecisionReader(session, dataset)
        _, following = list_boxes(session, reader, boxes, page)
        times.append(time.perf_counter() - begun)
        cursor = following or ""
    return times


def timed(work: Callable[[], object]) -> float:
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


def quantile(times: list[float], share: float) -> float:
    return sorted(times)[min(len(times) - 1, int(share * len(times)))]


if __name__ == "__main__":
    sys.exit(main())
