"""Damaged pages of an SQLite file are found after the start or on use, and reported."""

import sqlite3
from contextlib import closing

import pytest

from tests.support import plain_http
from tests.support.data_folders import served
from tests.support.waiting import until

pytestmark = pytest.mark.sqlite_files("its pages are damaged")

PAGE = 4096


def damage_first_page(data, name):
    """Overwrite the first page of a table or an index, so that reading it fails."""
    file = data / "unghost.db"
    with closing(sqlite3.connect(file)) as database:
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        query = "SELECT rootpage FROM sqlite_master WHERE name = ?"
        ((page,),) = database.execute(query, (name,)).fetchall()
    with file.open("r+b") as pages:
        pages.seek((page - 1) * PAGE)
        pages.write(b"\xff" * PAGE)


def get_readyz(server):
    return plain_http.get(f"{server.url}/readyz", timeout=60)


def error_details(response):
    return {
        fault["code"]: fault["detail"] for fault in response.json().get("errors", ())
    }


def test_damaged_page_read_by_a_request_returns_503_and_is_reported(filled):
    with served(filled) as (server, api):
        checks = lambda: get_readyz(server).json().get("checks", {})  # noqa: E731
        until(lambda: checks().get("pages") == "intact")
        log = server.log.read_text("utf-8")
        (dataset,) = api.json("/datasets")["items"]
        damage_first_page(filled, "ix_decisions_by_crowding")
        met = api.get("/boxes", dataset=dataset["name"], sort="crowding")
        until(lambda: "pages" in error_details(get_readyz(server)))
        response = get_readyz(server)

    assert "the pages of the database are intact" in log
    assert (met.status_code, met.json()["code"]) == (503, "database_damaged")
    assert "malformed" in error_details(response)["pages"]


@pytest.mark.parametrize(
    "name",
    ["decisions", pytest.param("ix_decisions_by_crowding", marks=pytest.mark.long)],
)
def test_damaged_pages_are_reported_by_readyz_log_and_doctor(filled, unghost, name):
    damage_first_page(filled, name)

    with served(filled) as (server, _):
        until(lambda: "the database is damaged: " in server.log.read_text("utf-8"))
        until(lambda: "table decisions" in get_readyz(server).text)
        response = get_readyz(server)
        log = server.log.read_text("utf-8")

    assert response.json()["code"] == "not_ready"
    pages = error_details(response)["pages"]
    assert "the database is damaged: " in pages
    assert "table decisions or an index of it: " in pages
    assert "restore the last backup" in pages
    assert "`unghost doctor` on the server says more" in pages
    assert "the database is damaged: table decisions or an index of it: " in log
    examined = unghost("doctor", "--json")
    assert examined.code != 0
    assert "table decisions or an index of it: " in examined.out
    assert "table boxes" not in examined.out
