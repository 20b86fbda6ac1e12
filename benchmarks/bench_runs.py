"""How fast are runs, previews and lists with a million stored boxes?

    python -m benchmarks.bench_runs [--boxes 1000000] [--json]

The dataset is made once and kept in ``benchmarks/.data``.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from app.boxes.filter import to_filter
from app.boxes.queries import PageRequest
from app.boxes.reader import DecisionReader, list_boxes
from app.catalog.datasets import DatasetRepository
from app.context import ServiceContext
from app.datasets.service import statistics as dataset_statistics
from app.db.tables import Run
from app.measuring.columns import ColumnCache
from app.memory import settle
from app.runs.flips import preview
from app.runs.service import RunRequest, request_run
from benchmarks.measuring import (
    DATA,
    opened,
    parser_of,
    quantile,
    seconds_of,
    show,
    store_million,
)
from filter_core.config.filter import FilterConfig
from tests.support.large_datasets import NAME
from unghost.wire.boxes import BoxSelection
from unghost.wire.runs import PreviewIn

PAGES = 60
ENDED = ("done", "failed", "cancelled")
REPEATS = 3


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--boxes", type=int, default=1_000_000)
    parser.add_argument("--data", type=Path, default=DATA)
    options = parser.parse_args()
    with opened(options.data) as context:
        store_million(context, options.boxes)
        settle()
        figures = {**runs(context), **previews(context), **lists(context)}
    show(figures, as_json=options.json)


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
    small_flip = FilterConfig(threshold_small_box=4.1)
    # Every box becomes out of range: the reason of each one changes.
    everything_flips = FilterConfig(min_distance=1000)
    few, many = [], []
    for _ in range(REPEATS):
        seconds, few_changed = decided(context, small_flip)
        few.append(seconds)
        decided(context, FilterConfig())
    for _ in range(REPEATS):
        seconds, many_changed = decided(context, everything_flips)
        back, _ = decided(context, FilterConfig())
        many += [seconds, back]
    return {
        "run from cold, nothing flips [s]": cold,
        "boxes that flip in the small run": float(few_changed),
        "run with the small flip, median [s]": statistics.median(few),
        "boxes that flip in the large run": float(many_changed),
        "run with the large flip, median [s]": statistics.median(many),
    }


def previews(context: ServiceContext) -> dict[str, float]:
    body: dict[str, object] = {"config": {"threshold_small_box": 12}}
    request = PreviewIn.model_validate({**body, "limit": 100, "bins": 50})
    with context.database.read() as session:
        dataset = DatasetRepository(session).named(NAME)
        preview(context, session, dataset, request)
        measurement = dataset.active_measurement_id or 0
        held = context.one(ColumnCache).load(session, dataset.id, measurement)
        took = median(lambda: preview(context, session, dataset, request))
    numbers = held.evidence
    columns = [getattr(numbers, name) for name in READ_BY_A_DECISION]
    reference = median(lambda: [np.count_nonzero(each > 1) for each in columns])
    return {
        "preview with counts, histograms and flips [ms]": 1000 * took,
        "one numpy pass over the same columns [ms]": 1000 * reference,
        "preview / one pass": took / reference,
    }


def median(work: Callable[[], object]) -> float:
    return statistics.median(seconds_of(work) for _ in range(9))


READ_BY_A_DECISION = [
    "class_index",
    "state",
    "accept_mask",
    "measured",
    "box_pixels",
    "matched_pixels",
    "match_percent",
    "area_percent",
    "distance",
]

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
            boxes = to_filter(session, dataset, selection)
            times, cursor = [], ""
            for _ in range(PAGES):
                begun = time.perf_counter()
                page = PageRequest(sort, cursor, 100)
                reader = DecisionReader(session, dataset)
                _, following = list_boxes(session, reader, boxes, page)
                times.append(time.perf_counter() - begun)
                cursor = following or ""
            figures[f"list {name}, p95 [ms]"] = 1000 * quantile(times, 0.95)
        stats = [
            seconds_of(lambda: dataset_statistics(session, dataset))
            for _ in range(PAGES)
        ]
        figures["stats, p95 [ms]"] = 1000 * quantile(stats, 0.95)
    return figures


if __name__ == "__main__":
    main()
