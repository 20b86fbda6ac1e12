"""Alive, ready, and which version."""

from __future__ import annotations

import sqlite3
from importlib.metadata import version


def test_it_is_alive_and_ready(anybody):
    ready = anybody.get("/readyz")

    assert anybody.get("/healthz").json() == {"status": "ok"}
    assert ready.status_code == 200
    assert ready.json()["ready"] is True
    assert set(ready.json()["checks"]) == {"database", "migrations", "disk"}


def test_it_says_its_version(admin):
    answer = admin.get("/version").json()

    assert (answer["version"], answer["api"]) == (version("unghost"), "v1")


def test_a_full_disk_is_not_ready(serve):
    with serve(min_free_bytes=2**62).client() as client:
        answer = client.get("/readyz")

    assert (answer.status_code, answer.json()["code"]) == (503, "not_ready")
    assert [fault["code"] for fault in answer.json()["errors"]] == ["disk"]
    assert int(answer.headers["retry-after"]) > 0


def test_a_schema_of_another_version_is_not_ready(serve):
    service = serve()
    with sqlite3.connect(service.settings.data / "unghost.db") as database:
        database.execute("update alembic_version set version_num = '0000'")
    database.close()

    with service.client() as client:
        answer = client.get("/readyz")

    assert answer.status_code == 503
    assert [fault["code"] for fault in answer.json()["errors"]] == ["migrations"]
