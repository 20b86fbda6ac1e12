"""Bulk inserts and updates store rows as single statements would, on both databases."""

from collections.abc import Iterator
from contextlib import closing

import pytest
from sqlalchemy import select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.db.base import utc_now
from app.db.bulk import COPY_FROM_ROWS, ROWS_AT_A_TIME, insert_rows, update_rows
from app.db.engine import Database
from app.db.tables import Dataset, Frame, FrameEvidence, Measurement
from tests.support.databases import migrated_file, migrated_postgres

UNUSUAL_TEXTS = (
    "tab\there",
    "line\nend",
    "back\\slash",
    "\\N",
    "\\.",
    "Straße 道路 🚗",
    "",
    "'\"",
)
ROWS = 48


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def database(request, tmp_path_factory) -> Iterator[Database]:
    if request.param == "postgresql":
        with migrated_postgres() as url, closing(Database(url)) as database:
            yield database
        return
    file = tmp_path_factory.mktemp("bulk") / "bulk.db"
    file.write_bytes(migrated_file())
    with closing(Database(f"sqlite:///{file}")) as database:
        yield database


@pytest.fixture
def session(database) -> Iterator[Session]:
    with Session(database.engine) as session:
        yield session
        session.rollback()


@pytest.fixture
def dataset_id(session) -> int:
    dataset = Dataset(name="bulk", created_by="ada")
    session.add(dataset)
    session.flush()
    return dataset.id


def frames(dataset_id: int, count: int) -> list[dict]:
    """Rows of frames with texts that have to be escaped, NULL, JSON and times."""
    return [
        {
            "id": 1000 + number,
            "dataset_id": dataset_id,
            "key": f"{number:05}{UNUSUAL_TEXTS[number % len(UNUSUAL_TEXTS)]}",
            "revision": 1,
            "content_digest": "0" * 64,
            "config_id": 1,
            "run_id": 1,
            "first_box_id": 2**40 + number,
            "box_count": number,
            "width": None if number % 2 else 1280,
            "map": UNUSUAL_TEXTS[number % len(UNUSUAL_TEXTS)],
            "annotation": {
                "odd": UNUSUAL_TEXTS[number % len(UNUSUAL_TEXTS)],
                "half": number / 2,
            },
            "created_by": "ada",
            "created_at": utc_now(),
        }
        for number in range(count)
    ]


def stored_rows(session: Session, names: list[str]) -> list[tuple]:
    columns = [getattr(Frame, name) for name in names]
    return [tuple(row) for row in session.execute(select(*columns).order_by(Frame.id))]


@pytest.mark.parametrize("count", [1, COPY_FROM_ROWS - 1, COPY_FROM_ROWS, ROWS])
def test_inserted_rows_are_read_back_unchanged(session, dataset_id, count):
    rows = frames(dataset_id, count)

    insert_rows(session, Frame, rows)

    assert stored_rows(session, list(rows[0])) == [tuple(row.values()) for row in rows]


def test_bytes_booleans_and_nulls_are_inserted_unchanged(session, dataset_id):
    insert_rows(session, Frame, frames(dataset_id, ROWS))
    measurement = Measurement(
        dataset_id=dataset_id,
        digest="0" * 64,
        pixel_digest="0" * 64,
        options={},
        filter_core_version="1",
    )
    session.add(measurement)
    session.flush()
    rows = [
        {
            "id": 1000 + number,
            "frame_id": 1000 + number,
            "measurement_id": measurement.id,
            "numbers": bytes(range(256))[number:],
            "tag_counts": b"\\N\t\n\0",
            "geometry": b"",
            "channels": None if number % 2 else b"\0",
            "segmentation": None,
            "lossy": number % 3 == 0,
        }
        for number in range(ROWS)
    ]

    insert_rows(session, FrameEvidence, rows)

    columns = [getattr(FrameEvidence, name) for name in rows[0]]
    stored = session.execute(select(*columns).order_by(FrameEvidence.id))
    assert list(map(tuple, stored)) == [tuple(row.values()) for row in rows]


@pytest.mark.parametrize("count", [2, ROWS])
def test_duplicate_row_raises_integrity_error_without_its_values(
    session, dataset_id, count
):
    rows = frames(dataset_id, count)

    with pytest.raises(IntegrityError) as refused:
        insert_rows(session, Frame, [*rows, rows[0]])

    assert "Straße" not in str(refused.value)
    session.rollback()
    assert session.scalars(select(Frame.id)).all() == []


def test_update_rows_sets_columns_by_key(session, dataset_id):
    rows = frames(dataset_id, ROWS)
    insert_rows(session, Frame, rows)
    ids = [row["id"] for row in rows][1:]
    told: list[int] = []

    update_rows(
        session,
        Frame,
        {
            "id": ids,
            "width": [None if key % 3 else key for key in ids],
            "map": [f"map {key}" if key % 2 else None for key in ids],
        },
        told.append,
    )

    first, *others = stored_rows(session, ["id", "width", "map"])
    assert first == (1000, 1280, UNUSUAL_TEXTS[0])
    assert others == [
        (key, None if key % 3 else key, f"map {key}" if key % 2 else None)
        for key in ids
    ]
    assert sum(told) == len(ids)


def test_update_rows_sets_columns_to_null_and_reports_each_chunk(session, dataset_id):
    insert_rows(session, Frame, frames(dataset_id, ROWS))
    stored = list(session.scalars(select(Frame.id)))
    others = range(stored[-1] + 1, stored[-1] + 1 + ROWS_AT_A_TIME * 2 + 5 - ROWS)
    ids, told = [*stored, *others], list[int]()

    update_rows(session, Frame, {"id": ids, "map": [None] * len(ids)}, told.append)
    update_rows(session, Frame, {"id": [], "map": []})

    assert set(session.scalars(select(Frame.map))) == {None}
    assert told == [ROWS_AT_A_TIME, ROWS_AT_A_TIME, 5]
