"""PostgreSQL: rows inserted and changed per second, and bytes per frame and box.

    python -m benchmarks.bench_postgres [--boxes 1000000] [--server URL] [--json]

A new database is made on the server, filled, measured and dropped. Different ways to do
the same are measured alternately, on the real tables with their keys and indexes.
"""

from __future__ import annotations

import json
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
from sqlalchemy import bindparam, create_engine, insert, make_url, select, text, update
from sqlalchemy.orm import Session

from app.catalog.datasets import DatasetRepository
from app.context import ServiceContext
from app.datasets.service import NewDataset, create_dataset
from app.db.base import Base
from app.db.bulk import copy_in, execute_many, run_each, update_rows
from app.db.tables import Box, Decision, Flips, Frame, FrameEvidence, Run
from app.ingest.frame import UploadedFrame, UploadRequest
from app.ingest.service import add_frame
from app.measuring.plan import DatasetReading
from app.process.lifespan import running
from app.runs.queries import BOXES_PER_ROW, pack_flips
from app.security import Principal
from app.settings import Settings
from benchmarks.measuring import parser_of, progress, seconds_of, show
from benchmarks.street import HEIGHT, WIDTH
from filter_core.config.filter import FilterConfig
from filter_core.segmentation.palettes import FAMILIES
from tests.support.large_datasets import (
    BOXES_PER_FRAME,
    DatasetSpec,
    MadeRows,
    make_dataset,
    rows_of,
)

SERVER = "postgresql://postgres@127.0.0.1:5432/postgres"
SIZES = (1, 2, 4, 8, 16, 32, 64, 256, 1_000, 10_000)
ROWS_PER_SIZE = 10_000
REPEATS = 3
UPLOADED = 400
"""Frames that are stored as the service does it: pixels and all."""
ADA = Principal(1, "ada", "reviewer")
GROWING = ("frames", "frame_files", "blobs", "boxes", "evidence", "decisions")
Rows = list[dict[str, Any]]
Insert = Callable[[Session, type[Base], Rows], None]
Figures = dict[str, float]


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--boxes", type=int, default=1_000_000)
    parser.add_argument("--server", default=SERVER)
    options = parser.parse_args()
    with own_service(options.server) as context:
        # Rolled back rows still take space, so sizes are measured first.
        figures = {**sizes(context, options.boxes), **measured(context, options.boxes)}
    show(figures, as_json=options.json)


@contextmanager
def own_service(server: str) -> Iterator[ServiceContext]:
    """A service of a database that is dropped at the end."""
    url = make_url(Settings(database_url=server).sqlalchemy_url)
    name = f"unghost_bench_{uuid.uuid4().hex}"
    engine = create_engine(url, isolation_level="AUTOCOMMIT")
    with engine.connect() as admin, TemporaryDirectory() as folder:
        admin.execute(text(f"CREATE DATABASE {name}"))
        try:
            own = url.set(database=name).render_as_string(hide_password=False)
            with running(Settings(data=Path(folder), database_url=own)) as context:
                yield context
        finally:
            admin.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
    engine.dispose()


def one_by_one(session: Session, model: type[Base], rows: Rows) -> None:
    """What `insert_rows` does with few rows: the driver's executemany."""
    statement = insert(Base.metadata.tables[model.__tablename__])
    source = iter(rows)
    while chunk := list(islice(source, 10_000)):
        run_each(session, statement, chunk)


WAYS: dict[str, Insert] = {"executemany": one_by_one, "COPY": copy_in}


def measured(context: ServiceContext, boxes: int) -> Figures:
    make_dataset(context, DatasetSpec("rows", 4), progress)
    figures: Figures = {}
    for size in SIZES:
        figures |= inserting(context, size, ROWS_PER_SIZE, REPEATS)
    figures |= packed(context)
    figures |= inserting(context, boxes, boxes, 1)
    return figures | changing(context, min(boxes, 10 * ROWS_PER_SIZE))


def inserting(context: ServiceContext, size: int, rows: int, repeats: int) -> Figures:
    """Boxes and their decisions, `size` of each at a time; nothing is kept."""
    seconds: dict[str, list[float]] = {way: [] for way in WAYS}
    for _ in range(repeats):
        for way, insert_by in WAYS.items():
            with rolled_back(context) as session:
                made = new_rows(session, -(-rows // BOXES_PER_FRAME))
                boxes, decisions = made.boxes[:rows], made.decisions[:rows]
                begun = time.perf_counter()
                for start in range(0, rows, size):
                    insert_by(session, Box, boxes[start : start + size])
                    insert_by(session, Decision, decisions[start : start + size])
                seconds[way].append(time.perf_counter() - begun)
    return {
        f"boxes with decisions, {size:,} at a time, {way} [1/s]": rows / min(taken)
        for way, taken in seconds.items()
    }


@contextmanager
def rolled_back(context: ServiceContext) -> Iterator[Session]:
    with Session(context.database.engine) as session:
        yield session
        session.rollback()


def new_rows(session: Session, frames: int) -> MadeRows:
    """Rows of frames, of which those of the frames themselves are inserted."""
    (dataset,) = DatasetRepository(session).page(after="", limit=1)
    rng = np.random.default_rng(3)
    made = rows_of(session, dataset.id, DatasetSpec("", frames), rng)
    copy_in(session, Frame, made.frames)
    return made


def packed(context: ServiceContext) -> Figures:
    """Evidence of the frames of one transaction, and the flips of a run."""
    figures: Figures = {}
    for way, insert_by in WAYS.items():
        with rolled_back(context) as session:
            made = new_rows(session, 3_200)
            begun = time.perf_counter()
            for start in range(0, 3_200, 32):
                insert_by(session, FrameEvidence, made.evidence[start : start + 32])
            taken = time.perf_counter() - begun
            figures[f"evidence, 32 frames at a time, {way} [1/s]"] = 3_200 / taken
            flips = flips_of(session, 1_000_000)
            taken = seconds_of(partial(insert_by, session, Flips, flips))
            figures[f"flips of a million boxes, {way} [ms]"] = 1_000 * taken
    return figures


def flips_of(session: Session, boxes: int) -> Rows:
    run_id = session.scalars(select(Run.id).limit(1)).one()
    before, after = np.full(BOXES_PER_ROW, 1), np.full(BOXES_PER_ROW, 2)
    return [
        {
            "run_id": run_id,
            "first_box_id": first,
            "last_box_id": first + BOXES_PER_ROW - 1,
            "boxes": pack_flips(np.arange(first, first + BOXES_PER_ROW), before, after),
        }
        for first in range(1, boxes, BOXES_PER_ROW)
    ]


def changing(context: ServiceContext, rows: int) -> Figures:
    """What a run does: another reason for each decision, and other numbers."""
    figures: Figures = {}
    for way in ("executemany", "arrays"):
        with rolled_back(context) as session:
            made = new_rows(session, -(-rows // BOXES_PER_FRAME))
            boxes, decisions = made.boxes[:rows], made.decisions[:rows]
            copy_in(session, Box, boxes)
            copy_in(session, Decision, decisions)
            ids = [row["box_id"] for row in decisions]
            changed = {"box_id": ids, "reason": [2] * rows}
            work: Callable[[], object] = partial(
                update_rows, session, Decision, changed
            )
            if way == "executemany":
                statement = update(Decision).values(reason=bindparam("to_reason"))
                statement = statement.where(Decision.box_id == bindparam("box"))
                values = {"box": ids, "to_reason": changed["reason"]}
                work = partial(execute_many, session, statement, values)
            taken = seconds_of(work)
            figures[f"decisions changed, {way} [1/s]"] = rows / taken
    return figures


def sizes(context: ServiceContext, boxes: int) -> Figures:
    """Bytes per frame and per box: of frames as they are uploaded, and of many rows."""
    upload(context)
    figures = bytes_of(context, UPLOADED, "uploaded")
    emptied(context)
    make_dataset(
        context, DatasetSpec("full", boxes // BOXES_PER_FRAME, annotated=True), progress
    )
    sys.stderr.write("\n")
    figures |= bytes_of(context, boxes // BOXES_PER_FRAME, "made")
    emptied(context)
    return figures


def emptied(context: ServiceContext) -> None:
    with context.database.engine.begin() as connection:
        connection.execute(text(f"TRUNCATE {', '.join(GROWING)} CASCADE"))


def upload(context: ServiceContext) -> None:
    """Store frames as the service does, with boxes on a segmentation of many things."""
    rng = np.random.default_rng(11)
    with context.database.write() as session:
        reading = DatasetReading("uploaded")
        create_dataset(session, NewDataset(reading, "", None, FilterConfig(), "ada"))
    for number in range(UPLOADED):
        content = json.dumps(annotation(rng, number)).encode()
        files = {"segmentation": segmentation(rng)}
        upload = UploadedFrame(f"town/{number:06}", content, files)
        add_frame(context, UploadRequest("uploaded", ADA), upload)


def annotation(rng: np.random.Generator, number: int) -> dict[str, Any]:
    corners = rng.integers(0, (1000, 500), (BOXES_PER_FRAME, 2))
    ends = corners + rng.integers(20, 200, (BOXES_PER_FRAME, 2))
    return {
        "carla_version": "0.9.15",
        "map": "Town10HD",
        "number": number,
        "camera": {"width": WIDTH, "height": HEIGHT, "fov": 90},
        "boxes": [
            {"id": f"actor-{at}", "class": "car", "xyxy": [*first, *last]}
            for at, (first, last) in enumerate(
                zip(corners.tolist(), ends.tolist(), strict=True)
            )
        ],
    }


def segmentation(rng: np.random.Generator) -> bytes:
    """An image of 200 rectangles of any tag, as PNG."""
    tags = np.zeros((HEIGHT, WIDTH), np.uint8)
    for _ in range(200):
        x, y = rng.integers(0, (WIDTH, HEIGHT))
        tags[y : y + rng.integers(10, 200), x : x + rng.integers(10, 200)] = (
            rng.integers(0, 23)
        )
    palette = FAMILIES["carla-0.9.14"]
    written, data = cv2.imencode(".png", palette.paint(tags)[..., ::-1])
    assert written
    return data.tobytes()


def bytes_of(context: ServiceContext, frames: int, what: str) -> Figures:
    """The size of each table that grows with the frames, and of its indexes."""
    statement = text(
        "SELECT pg_table_size(c.oid), pg_indexes_size(c.oid) FROM pg_class c "
        "WHERE c.oid = CAST(:name AS regclass)"
    )
    figures: Figures = {}
    every = 0.0
    with context.database.engine.connect() as connection:
        for name in GROWING:
            rows, indexes = connection.execute(statement, {"name": name}).one()
            figures[f"{what}: {name}, rows [B/frame]"] = rows / frames
            figures[f"{what}: {name}, indexes [B/frame]"] = indexes / frames
            every += rows + indexes
    figures[f"{what}: all tables [B/frame]"] = every / frames
    figures[f"{what}: all tables [B/box]"] = every / frames / BOXES_PER_FRAME
    return figures


if __name__ == "__main__":
    main()
