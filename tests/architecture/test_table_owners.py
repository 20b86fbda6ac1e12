"""Each table is written by one package of the service only."""

from typing import Final

import pytest

from app.db import tables  # noqa: F401  # defines the tables
from app.db.base import Base
from app.db.tables import access  # noqa: F401  # defines the rest of them

OWNERS: Final = {
    "access": ("Token", "LoginSession", "LoginCode", "DownloadLink", "AuditEntry"),
    "boxes": ("Blob", "Frame", "FrameFile", "Box", "IdBlock", "Decision", "Tally"),
    "hooks": ("Hook", "HookDelivery", "PendingReview"),
    "http": ("IdempotencyKey",),
    "exports": ("Export",),
    "catalog": ("Dataset", "DatasetClass", "ConfigVersion", "Problem"),
    "jobs": ("Chunk", "Lease", "Installation"),
    "measuring": ("Measurement", "FrameEvidence"),
    "review": ("Review", "ReviewBatch", "Claim"),
    "runs": ("Run", "Flips"),
}
"""The tables that each package writes; any package may read them."""
WRITTEN_BY_JOBS: Final = {("jobs", "Run"), ("jobs", "Export")}
"""(package, table) where a package writes a table of another one.

Jobs keep the state of a run or an export in the row of that run or export.
"""
DELETING: Final = ("app/maintenance/removals.py", "app/maintenance/queries.py")
"""Modules that may delete rows of all tables: those of deleted datasets, and blobs
that no frame uses."""
WRITTEN_BY_ONE_MODULE: Final = {
    "app/boxes/current.py": ("Decision", "Tally"),
    "app/review/queries.py": ("Review", "ReviewBatch", "Claim"),
}
"""Tables that only one module of their package writes, so that counts have one rule."""
TABLE_OF: Final = {
    mapper.class_.__tablename__: mapper.class_.__name__
    for mapper in Base.registry.mappers
}
"""The table of each name in the database."""


@pytest.fixture(scope="module")
def writes(recorded_access) -> set[tuple[str, str]]:
    """(module's file, table) of what was written during a walk over the API."""
    return {
        (f"{module.replace('.', '/')}.py", TABLE_OF[table])
        for module, table in recorded_access.writes
        if table in TABLE_OF
    } - {(module, table) for module in DELETING for table in TABLE_OF.values()}


def test_every_table_has_an_owner():
    owned = [name for names in OWNERS.values() for name in names]

    assert sorted(owned) == sorted(TABLE_OF.values())


def test_table_is_written_only_by_its_owner(writes):
    owner = {name: package for package, names in OWNERS.items() for name in names}
    pairs = {(module.split("/")[1], table) for module, table in writes}

    assert {table for _, table in pairs} >= {"Decision", "Frame", "Review", "Run"}
    by_others = {write for write in pairs if owner[write[1]] != write[0]}
    assert by_others == WRITTEN_BY_JOBS
    for module, names in WRITTEN_BY_ONE_MODULE.items():
        assert {source for source, name in writes if name in names} == {module}
