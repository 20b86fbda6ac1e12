"""Each table is written by one package of the service only.

A module directly below `app` counts as a package.
"""

from __future__ import annotations

import ast
from collections import Counter
from functools import cache
from typing import Final

from app.db import tables  # noqa: F401  # defines the tables
from app.db.base import Base
from app.db.tables import access  # noqa: F401  # defines the rest of them
from tests.support.sources import Source, python_sources
from tests.support.syntax import name_of

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
WRITTEN_BY_JOBS: Final = {("jobs", "runs"), ("jobs", "exports")}
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
WRITES: Final = frozenset(
    {"insert", "update", "delete", "insert_into", "insert_of_dialect"}
    | {"insert_rows", "insert_columns", "update_rows"}
)


@cache
def written_tables(source: Source) -> frozenset[str]:
    """The tables in which a module inserts, updates or deletes rows.

    Found are statements (`update`, `sa.update`), and assignments to an attribute whose
    name is that of a column in one table only.
    """
    found: set[str] = set()
    for node in ast.walk(source.tree):
        if isinstance(node, ast.Call) and name_of(node.func) in WRITES:
            # The table is the first argument, or the second one after a session.
            found |= TABLES & {name_of(one) for one in node.args[:2]}
        elif isinstance(node, ast.Assign | ast.AugAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            for each in targets:
                found |= {TABLE_OF[name] for name in columns_set(each)}
    return frozenset(found)


def columns_set(target: ast.expr) -> list[str]:
    """The columns that an assignment sets on another object than `self`."""
    parts = target.elts if isinstance(target, ast.Tuple) else [target]
    return [
        part.attr
        for part in parts
        if isinstance(part, ast.Attribute)
        and part.attr in TABLE_OF
        and name_of(part.value) != "self"
    ]


TABLES: Final = {mapper.class_.__name__ for mapper in Base.registry.mappers}
SHARED_NAMES: Final = frozenset({"annotation", "until"})
"""Names of columns that are attributes of other objects than rows, too."""
_COLUMNS: Final = [
    (column.key, mapper.class_.__name__)
    for mapper in Base.registry.mappers
    for column in mapper.column_attrs
]
_TABLES_WITH: Final = Counter(name for name, _ in _COLUMNS)
TABLE_OF: Final = {
    name: table
    for name, table in _COLUMNS
    if _TABLES_WITH[name] == 1 and name not in SHARED_NAMES
}
"""The table of each column name that only one table has."""


def test_every_table_has_an_owner():
    owned = [name for names in OWNERS.values() for name in names]

    assert sorted(owned) == sorted(TABLES)


def test_table_is_written_only_by_its_owner():
    owner = {name: package for package, names in OWNERS.items() for name in names}
    found = {
        (source.name.split("/")[1], name)
        for source in python_sources("app")
        if source.name not in DELETING
        for name in written_tables(source)
    }

    by_others = {one for one in found if owner[one[1]] != one[0]}

    assert found - by_others, "no statement was recognised"
    assert by_others == set()


def test_table_is_written_only_by_its_owner_at_run_time(recorded_access):
    owner = {
        mapper.class_.__tablename__: package
        for package, names in OWNERS.items()
        for mapper in Base.registry.mappers
        if mapper.class_.__name__ in names
    }
    found = {
        (module.split(".")[1], table)
        for module, table in recorded_access.writes
        if f"{module.replace('.', '/')}.py" not in DELETING and table in owner
    }

    assert {table for _, table in found} >= {"decisions", "frames", "reviews", "runs"}
    by_others = {one for one in found if owner[one[1]] != one[0]}
    assert by_others == WRITTEN_BY_JOBS


def test_decisions_and_answers_are_written_by_a_single_module():
    found = {
        (source.name, name)
        for source in python_sources("app")
        if source.name not in DELETING
        for name in written_tables(source)
    }

    for module, names in WRITTEN_BY_ONE_MODULE.items():
        assert {source for source, name in found if name in names} == {module}


def test_table_writes_are_detected():
    text = """
update(Decision)
insert_columns(session, Box, rows)
sa.delete(tables.Claim)
dataset.active_run_id, other = 1, 2
self.owner_of_nothing = 3
select(Frame)
"""

    assert written_tables(Source("app/x.py", text)) == {
        *("Decision", "Box", "Claim", "Dataset")
    }
