"""The routes that say whether the service is alive and ready, and its version."""

from __future__ import annotations

from importlib.metadata import version


def test_a_service_is_alive_and_ready(anonymous):
    ready = anonymous.get("/readyz")

    assert anonymous.get("/healthz").json() == {"status": "ok"}
    assert ready.status_code == 200
    assert ready.json()["ready"] is True
    assert set(ready.json()["checks"]) == {
        *("database", "pages", "migrations", "disk", "blobs", "event_loop")
    }


def test_a_service_says_its_version(admin):
    answer = admin.get("/version").json()

    assert (answer["version"], answer["api"]) == (version("unghost"), "v1")
