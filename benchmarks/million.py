"""A dataset of a million stored boxes, made as rows: no pixel is measured for it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.random import Generator
from sqlalchemy import insert
from sqlalchemy.orm import Session

from app.db.base import utc_now
from app.db.evidence_record import pack_numbers
from app.db.tables import Box, Dataset, Decision, Frame, FrameEvidence
from app.repositories.datasets import DatasetRepository
from app.repositories.frames import FrameRepository
from app.repositories.tallies import TallyRepository
from app.services.context import ServiceContext
from app.services.datasets import NewDataset, create_dataset
from app.services.measuring import DatasetReading
from app.services.statistics import tallies_of
from filter_core.config import FilterConfig
from filter_core.decide import decide
from filter_core.types import Evidence

BOXES_PER_FRAME = 25
FRAMES_PER_TRANSACTION = 400
NAME = "million"


def fill(context: ServiceContext, boxes: int, progress: Callable[[int], None]) -> int:
    """Store the dataset; its id."""
    with context.database.write() as session:
        wanted = NewDataset(DatasetReading(NAME), "", None, FilterConfig(), "benchmark")
        dataset_id = create_dataset(session, wanted).id
    rng = np.random.default_rng(20240401)
    done = 0
    for size in _portions(boxes // BOXES_PER_FRAME):
        with context.database.write() as session:
            _store(session, dataset_id, size, rng)
        done += size * BOXES_PER_FRAME
        progress(done)
    return dataset_id


def _portions(frames: int) -> Iterator[int]:
    while frames > 0:
        yield min(frames, FRAMES_PER_TRANSACTION)
        frames -= FRAMES_PER_TRANSACTION


def _store(session: Session, dataset_id: int, count: int, rng: Generator) -> None:
    dataset = DatasetRepository(session).with_id(dataset_id)
    classes = DatasetRepository(session).classes(dataset_id)
    frames = FrameRepository(session)
    first_frame, first_box = frames.take_ids(count, count * BOXES_PER_FRAME)
    evidence = numbers(count * BOXES_PER_FRAME, tuple(classes), rng)
    class_ids = list(classes.values())
    rows, packed = [], []
    for index in range(count):
        part = np.arange(index * BOXES_PER_FRAME, (index + 1) * BOXES_PER_FRAME)
        frame_id = first_frame + index
        rows.append(_frame(dataset, frame_id, first_box + int(part[0])))
        packed.append(
            {
                "frame_id": frame_id,
                "measurement_id": dataset.active_measurement_id,
                "numbers": pack_numbers(evidence.take(part), class_ids),
                "tag_counts": b"",
                "geometry": b"",
                "segmentation": {"palette": "carla-0.9.14", "lossy": False},
                "lossy": False,
            }
        )
    session.execute(insert(Frame), rows)
    session.execute(insert(FrameEvidence), packed)
    boxes, current = _box_rows(
        dataset_id, (first_frame, first_box), class_ids, evidence
    )
    session.execute(insert(Box), boxes)
    session.execute(insert(Decision), current)
    alike = ((r["class_id"], r["reason"], r["toss_up"], None) for r in current)
    TallyRepository(session).add(dataset_id, tallies_of(alike))


def _frame(dataset: Dataset, frame_id: int, first_box: int) -> dict[str, Any]:
    return {
        "id": frame_id,
        "dataset_id": dataset.id,
        "key": f"{frame_id:08d}",
        "revision": 1,
        "content_digest": f"{frame_id:064d}",
        "config_id": dataset.active_config_id,
        "run_id": dataset.active_run_id,
        "first_box_id": first_box,
        "box_count": BOXES_PER_FRAME,
        "width": 1280,
        "height": 720,
        "annotation": {"boxes": [{"id": str(n)} for n in range(BOXES_PER_FRAME)]},
        "created_by": "benchmark",
        "created_at": utc_now(),
    }


def numbers(count: int, names: tuple[str, ...], rng: Generator) -> Evidence:
    """Evidence like a town's: a peak of hidden boxes, a hill of visible ones."""
    box_pixels = rng.integers(60, 40_000, count)
    hidden = rng.random(count) < 0.45
    share = np.where(hidden, rng.beta(0.5, 8, count), rng.beta(6, 2.5, count))
    matched = np.where(rng.random(count) < 0.3, 0, (share * box_pixels)).astype(int)
    return Evidence(
        class_names=names,
        class_index=rng.integers(0, len(names), count).astype(np.int32),
        state=np.zeros(count, np.uint8),
        accept_mask=np.full(count, 1 << 14, np.int64),
        measured=np.ones(count, bool),
        box_pixels=box_pixels,
        matched_pixels=matched,
        image_pixels=np.full(count, 1280 * 720),
        match_percent=100.0 * matched / box_pixels,
        area_percent=100.0 * box_pixels / (1280 * 720),
        crowding=np.where(rng.random(count) < 0.7, 0.0, 100 * rng.random(count)),
        distance=200 * rng.random(count),
        xyxy=np.tile([10.0, 10.0, 60.0, 50.0], (count, 1)),
    )


def _box_rows(
    dataset_id: int, first: tuple[int, int], class_ids: list[int], evidence: Evidence
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    first_frame, first_box = first
    decisions = decide(evidence, FilterConfig())
    class_of = [class_ids[index] for index in evidence.class_index.tolist()]
    boxes, rows = [], []
    for index in range(len(evidence)):
        frame_id = first_frame + index // BOXES_PER_FRAME
        boxes.append(
            {
                "id": first_box + index,
                "frame_id": frame_id,
                "class_id": class_of[index],
                "source_id": str(index % BOXES_PER_FRAME),
            }
        )
        rows.append(
            {
                "box_id": first_box + index,
                "dataset_id": dataset_id,
                "frame_id": frame_id,
                "class_id": class_of[index],
                "match_percent": float(evidence.match_percent[index]),
                "crowding": float(evidence.crowding[index]),
                "distance": float(evidence.distance[index]),
                "reason": int(decisions.reason[index]),
                "large": bool(decisions.large[index]),
                "toss_up": bool(decisions.toss_up[index]),
                "revision": 0,
            }
        )
    return boxes, rows
