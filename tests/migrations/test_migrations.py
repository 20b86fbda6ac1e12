"""Migrations up and down, on SQLite and on PostgreSQL, and what they refuse."""

import importlib
import json
import subprocess
import sys

import pytest
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from sqlalchemy import inspect, select, text
from sqlalchemy.exc import DBAPIError, IntegrityError
from sqlalchemy.orm import Session

from app.db import tables
from app.db.base import Base, utc_now
from app.db.migrate import WouldLose, current_revision, head_revision, is_known, migrate
from app.db.tables import access as access_tables
from app.package import migrations_dir
from filter_core.verdicts import Reason
from tests.support.databases import FILE, give_tables, migrated_file, rows_of
from tests.support.filled_database import contents, fill, revisions

SCRIPTS = migrations_dir()
TOKENS = access_tables.Token.__tablename__
BEFORE_HOOKS = "0023"
"""Rows of this revision: a downgrade refuses to lose hooks."""
DECIDE = text("UPDATE decisions SET reason = :reason WHERE box_id = :box")
NAMED = text("SELECT verdict, reason FROM readable_decisions WHERE box_id = :box")
EXPORT = text(
    "INSERT INTO exports (dataset_id, format, options, state, created_by, created_at)"
    " VALUES (:dataset, 'yolo', '{}', :state, 'ada', '2026-01-01')"
)


def add_dataset(session: Session, name: str) -> tables.Dataset:
    dataset = tables.Dataset(name=name, created_by="ada")
    session.add(dataset)
    session.flush()
    session.add(tables.DatasetClass(dataset_id=dataset.id, position=0, name="car"))
    session.flush()
    return dataset


def test_migrations_run_up_down_and_up_again(migrated):
    first = sorted(inspect(migrated).get_table_names())
    migrate(migrated, SCRIPTS, "base")
    emptied = inspect(migrated).get_table_names()
    migrate(migrated, SCRIPTS)

    assert emptied == ["alembic_version"]
    assert sorted(inspect(migrated).get_table_names()) == first
    assert TOKENS in first
    assert current_revision(migrated) == head_revision(SCRIPTS)


def test_migration_files_are_named_by_their_revisions():
    """The names of their files say which revisions there are, without Alembic."""
    ids = revisions()

    assert head_revision(SCRIPTS) == ids[-1]
    assert ids == sorted(ids)
    assert all(is_known(SCRIPTS, revision) for revision in ids)
    assert not is_known(SCRIPTS, "9999")
    assert not is_known(SCRIPTS, "")


def test_current_schema_starts_without_importing_alembic(tmp_path):
    serve = (
        "import sys; from pathlib import Path; import app.main;"
        "from app.process.lifespan import running; from app.settings import Settings;"
        f"context = running(Settings(data=Path({str(tmp_path)!r})));"
        "context.__enter__(); print('alembic' in sys.modules);"
        "context.__exit__(None, None, None)"
    )
    (tmp_path / FILE).write_bytes(migrated_file())

    served = subprocess.run(
        [sys.executable, "-c", serve], check=True, capture_output=True, text=True
    )

    assert served.stdout.strip() == "False"


def test_models_match_the_migrated_schema(migrated):
    here = migrated.dialect.name

    def is_of_this_kind(item, *_):
        return getattr(item, "info", {}).get("only", here) == here

    with migrated.connect() as connection:
        options = {"compare_type": True, "include_object": is_of_this_kind}
        context = MigrationContext.configure(connection, opts=options)
        differences = compare_metadata(context, Base.metadata)
    names = {
        check["name"]
        for table in ("runs", "exports", "decisions", "reviews")
        for check in inspect(migrated).get_check_constraints(table)
    }

    assert differences == []
    assert {"ck_runs_state", "ck_exports_state", "ck_decisions_reason"} <= names
    assert {"ck_decisions_review", "ck_reviews_verdict"} <= names


def test_foreign_keys_are_enforced_and_deletes_cascade(migrated):
    """Downgrades that would lose datasets, or that find deleted ones, are refused."""
    with Session(migrated) as session, session.begin():
        orphans = add_dataset(session, "parent").id + 1

    with Session(migrated) as session:
        session.add(tables.DatasetClass(dataset_id=orphans, position=0, name="car"))
        with pytest.raises(IntegrityError):
            session.flush()
    with pytest.raises(WouldLose, match="rows of datasets"):
        migrate(migrated, SCRIPTS, "base")
    with Session(migrated) as session, session.begin():
        (dataset,) = session.scalars(select(tables.Dataset))
        assert dataset.name == "parent"
        dataset.removed_at = utc_now()
    with pytest.raises(RuntimeError, match="datasets that were deleted are not gone"):
        migrate(migrated, SCRIPTS, "0007")
    assert current_revision(migrated) == head_revision(SCRIPTS)

    with Session(migrated) as session, session.begin():
        session.execute(text("DELETE FROM datasets"))
    with Session(migrated) as session:
        assert session.scalars(select(tables.DatasetClass.id)).all() == []


def test_frames_get_the_weather_and_boxes_the_distances_that_they_came_with(engine):
    migrate(engine, SCRIPTS, "0023")
    fill(engine, "0023")
    told = {"weather": {"preset": "WetNoon"}, "boxes": [{"distance_range": [50, 100]}]}
    with engine.begin() as connection:
        frame, box = connection.execute(
            text("SELECT frame_id, box_id FROM decisions LIMIT 1")
        ).one()
        connection.execute(
            text("UPDATE frames SET annotation = :told, first_box_id = :box"),
            {"told": json.dumps(told), "box": box},
        )
        connection.execute(text("UPDATE decisions SET distance = NULL"))

    migrate(engine, SCRIPTS)

    with engine.connect() as connection:
        assert connection.execute(
            text(
                "SELECT weather, distance_from, distance_to FROM decisions "
                "JOIN frames ON frames.id = frame_id WHERE frame_id = :frame"
            ),
            {"frame": frame},
        ).first() == ("WetNoon", 50, 100)


def test_exports_keep_their_ids_through_downgrade_and_upgrade(migrated):
    with Session(migrated) as session, session.begin():
        dataset = add_dataset(session, "labelled").id
    migrate(migrated, SCRIPTS, "0002")
    with Session(migrated) as session, session.begin():
        for state in ("done", "cancelled"):
            session.execute(EXPORT, {"dataset": dataset, "state": state})

    migrate(migrated, SCRIPTS, "0001")
    migrate(migrated, SCRIPTS)

    with Session(migrated) as session:
        rows = session.execute(text("SELECT id, state, done FROM exports ORDER BY id"))
        assert [tuple(row) for row in rows] == [(1, "done", 0), (2, "failed", 0)]


def test_every_reason_can_be_stored_and_is_named_in_the_view(migrated):
    fill(migrated, revisions()[-1])
    shown = {}

    with migrated.begin() as connection:
        decided = connection.execute(text("SELECT min(box_id) FROM decisions"))
        values = {"box": decided.scalar_one()}
        for reason in Reason:
            connection.execute(DECIDE, values | {"reason": int(reason)})
            shown[reason] = connection.execute(NAMED, values).one()
    with pytest.raises(IntegrityError), migrated.begin() as connection:
        connection.execute(DECIDE, values | {"reason": 1 + max(Reason)})

    assert shown == {reason: (reason.verdict.value, reason.label) for reason in Reason}


COUNTED = "SELECT reason, count(*) FROM decisions GROUP BY reason ORDER BY reason"
TALLIED = "SELECT reason, sum(boxes) FROM tallies GROUP BY reason ORDER BY reason"


@pytest.mark.parametrize("profile", ["paper", "carlasimu"])
def test_boxes_of_unknown_classes_become_unmeasured_under_profile_paper(
    engine, profile
):
    migrate(engine, SCRIPTS, "0011")
    fill(engine, "0011")
    with engine.begin() as connection:
        for statement in (
            "UPDATE decisions SET reason = 5",
            "DELETE FROM tallies",
            "INSERT INTO tallies (dataset_id, class_id, reason, toss_up, review, boxes)"
            " SELECT dataset_id, class_id, 5, false, '', count(*) FROM decisions"
            " GROUP BY dataset_id, class_id",
        ):
            connection.execute(text(statement))
        boxes = connection.execute(text("SELECT count(*) FROM decisions")).scalar_one()
        connection.execute(
            text("UPDATE config_versions SET body = :body"),
            {"body": json.dumps({"profile": profile})},
        )

    def stored():
        with engine.connect() as connection:
            return [
                [tuple(map(int, row)) for row in connection.execute(text(query))]
                for query in (COUNTED, TALLIED)
            ]

    migrate(engine, SCRIPTS)
    above = stored()
    migrate(engine, SCRIPTS, "0011")

    reason = Reason.UNMAPPED_CLASS if profile == "paper" else Reason.DROPPED_CLASS
    assert above == [[(int(reason), boxes)]] * 2
    assert stored() == [[(int(Reason.DROPPED_CLASS), boxes)]] * 2


def note_token(engine):
    entry = {"actor": "ada", "action": "token.created", "subject": "bob"}
    with Session(engine) as session, session.begin():
        session.add(access_tables.AuditEntry(**entry, details={}))


def check_audit_log_is_append_only(engine):
    """The one entry of the log can be neither changed nor deleted."""
    with Session(engine) as session:
        for change in (
            "UPDATE audit_log SET actor = 'nobody'",
            "DELETE FROM audit_log",
        ):
            with pytest.raises(DBAPIError, match="the audit log is only added to"):
                session.execute(text(change))
            session.rollback()
        (left,) = session.scalars(select(access_tables.AuditEntry))
    assert (left.actor, left.subject, left.token_id) == ("ada", "bob", None)


def test_audit_log_is_append_only_and_a_downgrade_that_would_empty_it_refused(migrated):
    note_token(migrated)
    check_audit_log_is_append_only(migrated)

    with pytest.raises(WouldLose, match="lose the 1 rows of audit_log, and nothing"):
        migrate(migrated, SCRIPTS, "0004")
    assert current_revision(migrated) == head_revision(SCRIPTS)
    check_audit_log_is_append_only(migrated)

    migrate(migrated, SCRIPTS, "0004", may_lose=True)
    assert "audit_log" not in inspect(migrated).get_table_names()
    migrate(migrated, SCRIPTS)
    note_token(migrated)
    check_audit_log_is_append_only(migrated)


LOST = {
    "0010": ("UPDATE reviews SET undoes = 1 WHERE id = 1", "which answers were undone"),
    "0014": ("UPDATE datasets SET recording = '{\"layout\": \"yolo\"}'",
             "how folders are read"),
}  # fmt: skip
"""By the revision that has no place for it: a statement, and what would be lost."""


@pytest.mark.parametrize("revision", LOST)
def test_downgrade_that_would_lose_something_is_refused(migrated, revision):
    statement, lost = LOST[revision]
    fill(migrated, BEFORE_HOOKS)
    with migrated.begin() as connection:
        connection.execute(text(statement))
    above = contents(migrated)

    with pytest.raises(WouldLose, match=lost):
        migrate(migrated, SCRIPTS, revision)

    assert current_revision(migrated) == head_revision(SCRIPTS)
    assert contents(migrated) == above
    migrate(migrated, SCRIPTS, revision, may_lose=True)
    assert current_revision(migrated) == revision


def test_undone_bulk_answers_of_earlier_versions_are_known_as_undone(engine):
    migrate(engine, SCRIPTS, "0010")
    fill(engine, "0010")
    batch = text(
        "INSERT INTO review_batches (id, dataset_id, verdict, undoes_id, reviewer, "
        "created_at) SELECT :id, min(id), 'clear', :undoes, 'ada', '2026-01-01' "
        "FROM datasets"
    )
    answer = text(
        "INSERT INTO reviews (id, box_id, revision, verdict, comment, reviewer, "
        "batch_id, created_at) SELECT :id, min(id), :id, 'clear', '', 'ada', :id, "
        "'2026-01-01' FROM boxes"
    )
    with engine.begin() as connection:
        for number, undoes in ((71, None), (72, 71)):
            connection.execute(batch, {"id": number, "undoes": undoes})
            connection.execute(answer, {"id": number})

    migrate(engine, SCRIPTS)

    with engine.connect() as connection:
        rows = connection.execute(text("SELECT id, undoes FROM reviews WHERE id > 70"))
        assert sorted(tuple(row) for row in rows) == [(71, None), (72, 71)]


def test_a_downgrade_ends_sessions_and_keeps_tokens_and_the_audit_log(migrated):
    """Sessions, login codes and download links may end: people just sign in again."""
    fill(migrated, BEFORE_HOOKS)
    above = contents(migrated)

    migrate(migrated, SCRIPTS, "0007")

    below = contents(migrated)
    assert above["login_sessions"]
    assert below["login_sessions"] == []
    assert below.keys() == above.keys() - {
        *("login_codes", "download_links"),
        *("hooks", "hook_deliveries", "pending_reviews"),
    }
    used = [token.pop("last_used_at") for token in above["tokens"]]
    assert any(used)
    assert below["tokens"] == above["tokens"]
    assert below["audit_log"] == above["audit_log"]


@pytest.mark.sqlite_files("it reads a query plan of SQLite")
def test_undone_bulk_answers_are_migrated_by_box_and_not_batch_by_batch(tmp_path):
    """Else a bulk answer on a hundred thousand boxes would take half an hour."""
    give_tables(tmp_path / "data", {})
    script = importlib.import_module("migrations.versions.0011_undone_answers")

    plan = rows_of(tmp_path / "data", f"EXPLAIN QUERY PLAN {script.OF_UNDONE_BATCHES}")

    (undone,) = [step for *_, step in plan if "undone" in step]
    assert "(box_id=?)" in undone
