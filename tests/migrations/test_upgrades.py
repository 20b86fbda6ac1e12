"""Databases of every revision keep their rows on the way up and down.

Compared are the columns that both revisions have.
"""

import pytest
from sqlalchemy import inspect

from app.db.engine import make_engine
from app.db.inspection import revision_of
from app.db.migrate import head_revision, migrate
from app.package import migrations_dir
from tests.support.api import Api
from tests.support.databases import change, give_tables
from tests.support.filled_database import (
    ROWS,
    contents,
    fill,
    restricted,
    revisions,
)
from tests.support.servers import running_server

SCRIPTS = migrations_dir()
REVISIONS = revisions()


def mostly_long(quick):
    """All revisions; those that are neither `quick` nor among the last are long."""
    return [
        revision
        if revision in {*quick, *REVISIONS[-3:]}
        else pytest.param(revision, marks=pytest.mark.long)
        for revision in REVISIONS
    ]


def rows_after_downgrade(rows, revision):
    """The rows as they are after a downgrade: 0001 has "failed" for "cancelled"."""
    if revision == "0001":
        for export in rows["exports"]:
            if export["state"] == "cancelled":
                export["state"] = "failed"
    return rows


def without_sessions(rows, revision):
    """The rows without sessions, which end on the way to 0008 and back from it.

    Before 0008 sessions were cookies.
    """
    return {**rows, "login_sessions": []} if revision < "0008" else rows


# The others have the same rows as those before them.
@pytest.mark.parametrize(
    "revision", mostly_long({file.name.partition(".")[0] for file in ROWS.iterdir()})
)
def test_rows_of_a_revision_survive_upgrade_and_downgrade(engine, revision):
    migrate(engine, SCRIPTS, revision)
    fill(engine, revision)
    before = contents(engine)
    empty = [table for table, rows in before.items() if not rows]
    assert empty == [], f"{revision}: put rows into tests/migrations/rows"

    migrate(engine, SCRIPTS)
    above = contents(engine)
    migrate(engine, SCRIPTS, revision)

    expected = without_sessions(before, revision)
    assert restricted(above, expected) == restricted(expected, expected)
    assert contents(engine) == expected


# A downgrade passes all revisions between.
@pytest.mark.parametrize("revision", mostly_long(REVISIONS[::5]))
def test_shared_columns_survive_downgrade_and_upgrade(migrated, revision):
    fill(migrated, REVISIONS[-1])
    above = contents(migrated)

    migrate(migrated, SCRIPTS, revision, may_lose=True)
    below = contents(migrated)
    migrate(migrated, SCRIPTS)

    if revision < "0008":
        assert not below.get("login_sessions")
    expected = rows_after_downgrade(restricted(above, below), revision)
    by_content = {table: sorted(rows, key=repr) for table, rows in expected.items()}
    assert restricted(below, below) == by_content
    assert restricted(contents(migrated), below) == by_content
    assert {*inspect(migrated).get_table_names()} - {"alembic_version"} <= above.keys()


@pytest.mark.sqlite_files("its file is copied before it is migrated")
@pytest.mark.parametrize("revision", [REVISIONS[0], REVISIONS[-2]])
def test_server_migrates_an_old_database_and_keeps_a_copy(tmp_path, revision):
    data = tmp_path / "data"
    data.mkdir()
    engine = make_engine(f"sqlite:///{data}/unghost.db")
    migrate(engine, SCRIPTS, revision)
    fill(engine, revision)
    before = contents(engine)
    engine.dispose()

    with running_server(data) as server:
        api = Api.at(server.url, server.headers)
        with api.http:
            boxes = api.boxes("street-1")

    reviews = [(box["verdict"], box["review"]["verdict"]) for box in boxes]
    assert sorted(reviews) == [
        ("kept", "keep"),
        ("rejected", "unsure"),
        ("unmeasured", "reject"),
        ("unmeasured", "reject"),
    ]
    copy = data / f"unghost.db.schema-{revision}"
    assert revision_of(data / "unghost.db") == head_revision(SCRIPTS)
    assert revision_of(copy) == revision
    kept = make_engine(f"sqlite:///{copy}")
    assert contents(kept) == before
    kept.dispose()


@pytest.mark.sqlite_files("its file is copied before it is migrated")
def test_database_of_a_newer_version_is_refused_and_unchanged(tmp_path):
    data = tmp_path / "data"
    give_tables(data, {})
    change(data, "UPDATE alembic_version SET version_num = '9999'")

    newer = pytest.raises(AssertionError, match="a newer Unghost wrote it")
    with newer, running_server(data):
        pass

    assert revision_of(data / "unghost.db") == "9999"
    assert [path.name for path in data.glob("*schema*")] == []
