"""Every table has one owner: the room of the service that alone writes its rows."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Final

from app.db import tables
from app.db.base import Base
from app.db.tables import access
from tests.architecture.sources import Source, python_sources

OWNERS: Final = {
    "access": ("Token", "LoginSession", "LoginCode", "DownloadLink", "AuditEntry"),
    "boxes": ("Blob", "Frame", "FrameFile", "Box", "IdBlock", "Decision", "Tally"),
    "http": ("IdempotencyKey",),
    "exports": ("Export",),
    "jobs": ("Chunk", "Lease", "Installation"),
    "measuring": (
        *("Dataset", "DatasetClass", "ConfigVersion", "Measurement"),
        *("FrameEvidence", "Problem"),
    ),
    "review": ("Review", "ReviewBatch", "Claim"),
    "runs": ("Run", "Flips"),
}
"""A row is read by whoever needs it, and written by one room."""
CLEARING: Final = ("app/maintenance/removals.py", "app/maintenance/queries.py")
"""Take away what a deleted dataset leaves in all tables, and blobs of no frame."""
ONE_DOOR: Final = {
    "app/boxes/current.py": ("Decision", "Tally"),
    "app/review/queries.py": ("Review", "ReviewBatch", "Claim"),
}
"""Tables that one module of their room writes, so that nobody counts in another way."""
WRITES: Final = frozenset(
    {"insert", "update", "delete", "upsert", "upsert_in", "insert_rows", "update_rows"}
)


def written(source: Source) -> Iterator[str]:
    """The tables in which a module inserts, updates or deletes rows by a statement."""
    for node in ast.walk(source.tree):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name):
            continue
        if node.func.id in WRITES:
            # The table comes first, or after the session.
            named = [one.id for one in node.args[:2] if isinstance(one, ast.Name)]
            yield from (name for name in named if name in TABLES)


TABLES: Final = {mapper.class_.__name__ for mapper in Base.registry.mappers}


def test_every_table_has_an_owner():
    owned = [name for names in OWNERS.values() for name in names]

    assert sorted(owned) == sorted(TABLES)
    assert tables is not None
    assert access is not None


def test_only_its_owner_writes_a_table():
    owner = {name: room for room, names in OWNERS.items() for name in names}
    found = {
        (source.name.split("/")[1], name)
        for source in python_sources("app")
        if source.name not in CLEARING
        for name in written(source)
    }

    strangers = {(room, name) for room, name in found if owner[name] != room}

    assert found - strangers, "no statement was recognised"
    assert strangers == set()


def test_decisions_and_answers_change_through_one_door():
    found = {
        (source.name, name)
        for source in python_sources("app")
        if source.name not in CLEARING
        for name in written(source)
    }

    for door, names in ONE_DOOR.items():
        assert {source for source, name in found if name in names} == {door}


def test_a_write_is_recognised():
    text = "update(Decision)\ninsert_rows(session, Box, rows)\nselect(Frame)"

    assert set(written(Source("app/x.py", text))) == {"Decision", "Box"}
