"""Commands on the server's own machine when its database is PostgreSQL."""

import shutil
import subprocess
from pathlib import Path

import pytest
from sqlalchemy import create_engine, make_url, text

from tests.support import frames as scene
from tests.support.api import Api
from tests.support.command_line import CommandLine
from tests.support.databases import empty_postgres, migrated_postgres
from tests.support.servers import running_server
from tests.support.services import filled_folder, running_services

SECRET = "s3cret-word"
WARNED, REFUSED, USAGE = 3, 1, 2
CHECKS = [
    *("token", "disk", "database", "schema", "keys", "durability"),
    *("audit", "answers", "counts"),
    *("files", "exports", "unused", "leftovers"),
]


@pytest.fixture
def url():
    with migrated_postgres() as url:
        yield url


@pytest.fixture
def unghost(tmp_path, url) -> CommandLine:
    return elsewhere(tmp_path, url)


@pytest.fixture
def filled(tmp_path: Path, url: str) -> Path:
    """A data folder with the files of two frames, whose rows are in the database."""
    return filled_folder(tmp_path / "data", database_url=url)


def change(url, *statements):
    engine = create_engine(url)
    with engine.begin() as connection:
        for statement in statements:
            connection.execute(text(statement))
    engine.dispose()


def elsewhere(tmp_path, url) -> CommandLine:
    settings = {"UNGHOST_DATA": str(tmp_path / "data"), "UNGHOST_DATABASE_URL": url}
    return CommandLine(tmp_path, settings)


def findings_by_check(result):
    return {finding["check"]: finding for finding in result.records}


def test_doctor_finds_no_fault_in_a_healthy_database(filled, unghost):
    result = unghost("doctor", "--verify", "--json")

    assert [finding["check"] for finding in result.records] == CHECKS
    wrong = [finding for finding in result.records if finding["severity"] != "ok"]
    # The PostgreSQL of the tests may be set up so that doctor warns of its durability.
    assert {finding["check"] for finding in wrong} <= {"durability"}
    assert result.code in (0, WARNED)
    assert findings_by_check(result)["database"]["found"].startswith("PostgreSQL ")


@pytest.mark.long
@pytest.mark.parametrize(
    ("statements", "check", "text"),
    [
        (["SET session_replication_role = replica", "DELETE FROM boxes WHERE id = 1"],
         "keys", "1 rows of decisions have no parent in boxes"),
        (["ALTER TABLE boxes DROP CONSTRAINT fk_boxes_frame_id"], "keys",
         "boxes has no key fk_boxes_frame_id"),
        (["UPDATE alembic_version SET version_num = '9999'"], "schema", "a newer"),
        (["UPDATE alembic_version SET version_num = '0001'"], "schema", "at 0001"),
    ],
)  # fmt: skip
def test_doctor_finds_database_faults(filled, unghost, url, statements, check, text):
    change(url, *statements)

    result = unghost("doctor", "--json")

    finding = findings_by_check(result)[check]
    assert text in finding["found"]
    assert finding["todo"]
    assert result.code in (REFUSED, WARNED)


@pytest.mark.long
def test_doctor_warns_of_synchronous_commit_off(filled, unghost, url):
    change(url, f"ALTER DATABASE {make_url(url).database} SET synchronous_commit = off")

    finding = findings_by_check(unghost("doctor", "--json"))["durability"]

    assert finding["severity"] == "warning"
    assert "synchronous_commit = off" in finding["found"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("place", "reason"),
    [("127.0.0.1:1/boxes", "refused"), ("{server}/unghost_nowhere", "does not exist")],
)
def test_unreachable_database_error_does_not_show_the_password(
    tmp_path, url, place, reason
):
    server = make_url(url)
    at = place.format(server=f"{server.host}:{server.port}")
    unghost = elsewhere(tmp_path, f"postgresql://postgres:{SECRET}@{at}")

    results = [
        unghost("doctor"),
        unghost("serve", "--port", "0"),
        unghost("backup", tmp_path / "kept"),
        unghost("gc"),
        unghost("token", "create", "ada", "--offline"),
    ]

    assert [result.code for result in results] == [REFUSED] * len(results)
    told = [f"{result.out}{result.err}" for result in results]
    assert SECRET not in "".join(told)
    assert "Traceback" not in "".join(told)
    for index in (0, 1, 3, 4):
        assert reason in told[index], told[index]


@pytest.mark.long
def test_unsupported_database_url_is_a_usage_error(tmp_path):
    unghost = elsewhere(tmp_path, f"mysql://root:{SECRET}@db/boxes")

    results = [unghost("doctor"), unghost("serve")]

    assert [result.code for result in results] == [USAGE, USAGE]
    for result in results:
        assert "UNGHOST_DATABASE_URL" in result.err
        assert "'mysql' is not supported" in result.err
        assert SECRET not in result.err


@pytest.mark.long
def test_database_password_is_not_logged_or_returned(tmp_path, url):
    log_in = make_url(url).set(password=SECRET).render_as_string(hide_password=False)
    settings = {"UNGHOST_DATABASE_URL": log_in, "UNGHOST_LOG_LEVEL": "debug"}
    with running_server(tmp_path / "data", settings) as server:
        api = Api.at(server.url, server.headers)
        with api.http:
            dataset = api.dataset()
            api.upload_frame(dataset, "a")
            change(url, "ALTER TABLE decisions RENAME TO elsewhere")
            failed = api.get("/boxes", dataset=dataset)
            seen = [failed.text, api.get("/version").text]
            seen.append(api.http.get("/readyz").text)

    assert failed.status_code >= 404
    assert SECRET not in "".join([*seen, server.log.read_text("utf-8")])


def test_token_created_offline_authenticates_at_the_service(filled, unghost, url):
    made = unghost("token", "create", "ada", "--role", "admin", "--offline")
    again = unghost("token", "create", "ada", "--offline")
    bad = unghost("token", "create", "a\nb", "--offline")

    with running_server(filled, {"UNGHOST_DATABASE_URL": url}) as server:
        api = Api.at(server.url, {"Authorization": f"Bearer {made.out.strip()}"})
        with api.http:
            session = api.json("/session")
            entries = api.json("/audit")["items"]

    assert (made.code, again.code, bad.code) == (0, REFUSED, USAGE)
    assert "a token named 'ada' exists already" in again.err
    assert (session["name"], session["role"]) == ("ada", "admin")
    acts = [[entry[key] for key in ("actor", "action", "subject")] for entry in entries]
    assert ["unghost", "token.created", "ada"] in acts


@pytest.mark.long
def test_offline_token_create_refuses_an_empty_database(tmp_path):
    with empty_postgres() as url:
        result = elsewhere(tmp_path, url)("token", "create", "ada", "--offline")

    assert result.code == REFUSED
    assert "start `unghost serve` once" in result.err


def test_backup_and_restore_with_postgres_are_refused_with_advice(
    filled, unghost, tmp_path, url
):
    made = unghost("backup", tmp_path / "kept")
    other = elsewhere(tmp_path / "other", url)
    other.folder.mkdir()
    restored = other("restore", tmp_path / "kept")

    assert (made.code, restored.code) == (REFUSED, REFUSED)
    assert "pg_dump --format=custom" in made.err
    assert "blobs" in made.err
    assert "pg_restore" in restored.err
    assert not (tmp_path / "kept").exists()


@pytest.mark.skipif(shutil.which("pg_dump") is None, reason="pg_dump is not installed")
def test_pg_dump_and_copy_of_the_files_can_be_restored(filled, tmp_path, url):
    """Follow docs/operations.md; a frame that is stored later is not in the backup."""
    dump, kept = tmp_path / "monday.dump", tmp_path / "monday-blobs"
    place = (
        make_url(url).set(drivername="postgresql").render_as_string(hide_password=False)
    )
    run_command("pg_dump", "--format=custom", f"--file={dump}", place)
    shutil.copytree(filled / "blobs", kept)
    with running_services(filled, database_url=url) as services:
        services.dataset().put("later", scene.annotation(), image=scene.image(9))

    with empty_postgres() as other:
        target = (
            make_url(other)
            .set(drivername="postgresql")
            .render_as_string(hide_password=False)
        )
        run_command(
            "pg_restore", "--exit-on-error", "--no-owner", f"--dbname={target}", dump
        )
        data = tmp_path / "restored"
        data.mkdir()
        shutil.copytree(kept, data / "blobs")
        settings = {"UNGHOST_DATA": str(data), "UNGHOST_DATABASE_URL": other}
        looked = CommandLine(tmp_path, settings)("doctor", "--verify", "--json")
        with running_server(data, {"UNGHOST_DATABASE_URL": other}) as server:
            api = Api.at(server.url, server.headers)
            with api.http:
                (dataset,) = api.json("/datasets")["items"]
                boxes = api.boxes(dataset["name"])
                again = api.upload_frame(dataset["name"], "new")

    assert {finding["severity"] for finding in looked.records} <= {
        "ok",
        "note",
        "warning",
    }
    assert findings_by_check(looked)["files"]["severity"] == "ok"
    assert len(boxes) == 4
    assert again["decisions"][0]["verdict"] == "kept"


def run_command(*words: object) -> None:
    done = subprocess.run(
        [str(word) for word in words], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
