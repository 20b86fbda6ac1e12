"""Makes datasets of many boxes as rows of the database, without measuring pixels."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator
from sqlalchemy.orm import Session

from app.boxes import current
from app.boxes.queries import FrameRepository
from app.catalog.datasets import DatasetRepository
from app.context import ServiceContext
from app.datasets.service import NewDataset, create_dataset
from app.db.base import utc_now
from app.db.bulk import insert_rows
from app.db.engine import Database
from app.db.migrate import migrate
from app.db.tables import Box, Dataset, Frame, FrameEvidence
from app.engine.local import LocalEngine
from app.measuring.evidence import pack_numbers
from app.measuring.plan import DatasetReading
from app.package import migrations_dir
from app.process.lifespan import folder_pool, pixel_pool, register_kinds
from app.settings import Settings
from app.storage.folder import FolderStorage
from filter_core.config.filter import FilterConfig
from filter_core.decisions.doubt import doubts
from filter_core.decisions.rules import decide
from filter_core.evidence_numbers import Evidence
from filter_core.pipeline import SegmentationReport
from tests.support.evidence import absent_evidence

BOXES_PER_FRAME = 25
FRAMES_PER_TRANSACTION = 400
NAME = "million"
RECTANGLE = [10.0, 10.0, 60.0, 50.0]


@dataclass(frozen=True)
class DatasetSpec:
    """A dataset to make; `annotated`: its boxes have everything that exports need."""

    name: str
    frames: int
    boxes_per_frame: int = BOXES_PER_FRAME
    annotated: bool = False
    seed: int = 20240401


def open_context(folder: Path) -> ServiceContext:
    """Open a data folder without driving its jobs; the caller closes the context.

    A server may use the folder at the same time.
    """
    register_kinds()
    folder.mkdir(parents=True, exist_ok=True)
    settings = Settings(data=folder)
    database = Database(settings.sqlalchemy_url)
    migrate(database.engine, migrations_dir())
    return ServiceContext(
        settings=settings,
        database=database,
        storage=FolderStorage(folder / "blobs"),
        engine=LocalEngine(settings.workers),
        pixels=pixel_pool(settings, settings.workers),
        drawers=pixel_pool(settings, 1),
        folders=folder_pool(settings),
    )


def fill(context: ServiceContext, boxes: int, progress: Callable[[int], None]) -> int:
    """Store the dataset of a million boxes, or of as many; its id."""
    return make_dataset(context, DatasetSpec(NAME, boxes // BOXES_PER_FRAME), progress)


def make_dataset(
    context: ServiceContext, spec: DatasetSpec, progress: Callable[[int], None]
) -> int:
    """Store a dataset as rows, and report the boxes stored so far; its id."""
    with context.database.write() as session:
        reading = DatasetReading(spec.name)
        new = NewDataset(reading, "", None, FilterConfig(), "benchmark")
        dataset_id = create_dataset(session, new).id
    rng = np.random.default_rng(spec.seed)
    done = 0
    for frames in _frames_per_transaction(spec.frames):
        with context.database.write() as session:
            _store(session, dataset_id, replace(spec, frames=frames), rng)
        done += frames * spec.boxes_per_frame
        progress(done)
    return dataset_id


def _frames_per_transaction(frames: int) -> Iterator[int]:
    while frames > 0:
        yield min(frames, FRAMES_PER_TRANSACTION)
        frames -= FRAMES_PER_TRANSACTION


class MadeRows(NamedTuple):
    """Rows of frames, of their evidence, and of their boxes with decisions."""

    frames: list[dict[str, Any]]
    evidence: list[dict[str, Any]]
    boxes: list[dict[str, Any]]
    decisions: list[dict[str, Any]]


def _store(
    session: Session, dataset_id: int, spec: DatasetSpec, rng: Generator
) -> None:
    made = rows_of(session, dataset_id, spec, rng)
    insert_rows(session, Frame, made.frames)
    insert_rows(session, FrameEvidence, made.evidence)
    insert_rows(session, Box, made.boxes)
    decisions = made.decisions
    current.add(
        session,
        dataset_id,
        {name: [row[name] for row in decisions] for name in decisions[0]},
    )


def rows_of(
    session: Session, dataset_id: int, spec: DatasetSpec, rng: Generator
) -> MadeRows:
    """New frames of a dataset as rows that are not stored yet."""
    dataset = DatasetRepository(session).with_id(dataset_id)
    classes = DatasetRepository(session).classes(dataset_id)
    each, count = spec.boxes_per_frame, spec.frames * spec.boxes_per_frame
    first = FrameRepository(session).take_ids(spec.frames, count)
    evidence = numbers(count, tuple(classes), rng)
    class_ids = list(classes.values())
    rows, packed = [], []
    for index in range(spec.frames):
        part = evidence.take(np.arange(index * each, (index + 1) * each))
        ids = first[0] + index, first[1] + index * each
        rows.append(_frame(dataset, ids, _annotation(part, spec.annotated)))
        numbers_of = pack_numbers(part, class_ids)
        packed.append(_evidence(dataset, ids[0], numbers_of))
    class_of = [class_ids[index] for index in evidence.class_index.tolist()]
    boxes = _boxes(first, class_of, each)
    return MadeRows(rows, packed, boxes, _current(dataset_id, boxes, evidence))


def _annotation(part: Evidence, annotated: bool) -> list[dict[str, Any]]:
    if not annotated:
        return [{"id": str(at)} for at in range(len(part))]
    return [
        {"id": str(at), "class": part.class_names[index], "xyxy": RECTANGLE}
        for at, index in enumerate(part.class_index.tolist())
    ]


def _frame(
    dataset: Dataset, ids: tuple[int, int], boxes: list[dict[str, Any]]
) -> dict[str, Any]:
    frame_id, first_box = ids
    return {
        "id": frame_id,
        "dataset_id": dataset.id,
        "key": f"{frame_id:08d}",
        "revision": 1,
        "content_digest": f"{frame_id:064d}",
        "config_id": dataset.active_config_id,
        "run_id": dataset.active_run_id,
        "first_box_id": first_box,
        "box_count": len(boxes),
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
        "segmentation": SegmentationReport(
            palette="carla-0.9.14",
            encoding="palette",
            channel_order="rgb",
            lossy=False,
            unknown_percent=0.0,
            notes=[],
        ),
        "lossy": False,
    }


def numbers(count: int, names: tuple[str, ...], rng: Generator) -> Evidence:
    """Made-up evidence: most matches near 0 (hidden boxes) or high (visible ones)."""
    box_pixels = rng.integers(60, 40_000, count)
    hidden = rng.random(count) < 0.45
    share = np.where(hidden, rng.beta(0.5, 8, count), rng.beta(6, 2.5, count))
    matched = np.where(rng.random(count) < 0.3, 0, (share * box_pixels)).astype(int)
    class_index = rng.integers(0, len(names), count).astype(np.int32)
    return replace(
        absent_evidence(names, class_index),
        accept_mask=np.full(count, 1 << 14, np.int64),
        measured=np.ones(count, bool),
        box_pixels=box_pixels,
        matched_pixels=matched,
        image_pixels=np.full(count, 1280 * 720),
        match_percent=100.0 * matched / box_pixels,
        area_percent=100.0 * box_pixels / (1280 * 720),
        crowding=np.where(rng.random(count) < 0.7, 0.0, 100 * rng.random(count)),
        distance=200 * rng.random(count),
        xyxy=np.tile(RECTANGLE, (count, 1)),
    )


def _boxes(
    first: tuple[int, int], class_of: list[int], each: int
) -> list[dict[str, Any]]:
    first_frame, first_box = first
    return [
        {
            "id": first_box + row,
            "frame_id": first_frame + row // each,
            "class_id": class_id,
            "source_id": str(row % each),
        }
        for row, class_id in enumerate(class_of)
    ]


def _current(
    dataset_id: int, boxes: list[dict[str, Any]], evidence: Evidence
) -> list[dict[str, Any]]:
    decisions = decide(evidence, FilterConfig())
    doubt = doubts(evidence, FilterConfig(), decisions).doubt
    return [
        {
            "box_id": box["id"],
            "dataset_id": dataset_id,
            "frame_id": box["frame_id"],
            "class_id": box["class_id"],
            "match_percent": float(evidence.match_percent[row]),
            "crowding": float(evidence.crowding[row]),
            "distance": float(evidence.distance[row]),
            "reason": int(decisions.reason[row]),
            "large": bool(decisions.large[row]),
            "toss_up": bool(decisions.toss_up[row]),
            "doubt": int(doubt[row]),
            "revision": 0,
        }
        for row, box in enumerate(boxes)
    ]
