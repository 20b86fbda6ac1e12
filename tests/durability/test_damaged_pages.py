"""Damaged pages of an SQLite file are found after the start or on use, and reported."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
from contextlib import closing

import pytest

from tests.support import plain_http
from tests.support.data_folders import served
from tests.support.waiting import until

pytestmark = pytest.mark.sqlite_files("its pages are damaged")

PAGE = 4096


def damage(data, name):
    """Overwrite the first page of a table or an index, so that reading it fails."""
    file = data / "unghost.db"
    with closing(sqlite3.connect(file)) as database:
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        asked = "SELECT rootpage FROM sqlite_master WHERE name = ?"
        ((page,),) = database.execute(asked, (name,)).fetchall()
    with file.open("r+b") as pages:
        pages.seek((page - 1) * PAGE)
        pages.write(b"\xff" * PAGE)


def ready(server):
    return plain_http.get(f"{server.url}/readyz", timeout=60)


def doctor(data):
    found = subprocess.run(
        [sys.executable, "-m", "unghost.cli", "doctor", "--json", "--data", str(data)],
        check=False,
        capture_output=True,
        text=True,
    )
    assert found.returncode != 0
    return found.stdout


def faults(answer):
    return {fault["code"]: fault["detail"] for fault in answer.json()["errors"]}


def test_whole_pages_are_said_to_be_whole(filled):
    with served(filled) as (server, _):
        until(lambda: ready(server).json()["checks"]["pages"] == "are whole")
        log = server.log.read_text("utf-8")

    assert "the pages of the database are intact" in log


@pytest.mark.parametrize(
    "name",
    ["decisions", pytest.param("ix_decisions_by_crowding", marks=pytest.mark.long)],
)
def test_damaged_pages_are_found_after_the_start(filled, name):
    damage(filled, name)

    with served(filled) as (server, _):
        until(lambda: "the database is damaged: " in server.log.read_text("utf-8"))
        until(lambda: "table decisions" in ready(server).text)
        answer = ready(server)
        log = server.log.read_text("utf-8")

    assert answer.json()["code"] == "not_ready"
    assert "the database is damaged: " in faults(answer)["pages"]
    assert "table decisions or an index of it: " in faults(answer)["pages"]
    assert "restore the last backup" in faults(answer)["pages"]
    assert "`unghost doctor` on the server says more" in faults(answer)["pages"]
    assert "the database is damaged: table decisions or an index of it: " in log
    examined = doctor(filled)
    assert "table decisions or an index of it: " in examined
    assert "table boxes" not in examined


def test_damage_that_is_met_while_serving_is_told(filled):
    with served(filled) as (server, api):
        until(lambda: ready(server).json()["checks"]["pages"] == "are whole")
        (dataset,) = api.json("/datasets")["items"]
        damage(filled, "ix_decisions_by_crowding")
        met = api.get("/boxes", dataset=dataset["name"], sort="crowding")
        until(lambda: ready(server).status_code == 503)
        answer = ready(server)

    assert (met.status_code, met.json()["code"]) == (503, "database_damaged")
    assert "malformed" in faults(answer)["pages"]
