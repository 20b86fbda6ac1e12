"""The routes that say whether the service is alive and ready, and its version."""

from __future__ import annotations

from importlib.metadata import version


def test_healthz_and_readyz_of_a_running_service_are_ok(anonymous):
    ready = anonymous.get("/readyz")

    assert anonymous.get("/healthz").json() == {"status": "ok"}
    assert ready.status_code == 200
    assert ready.json()["ready"] is True
    assert set(ready.json()["checks"]) == {
        *("database", "pages", "migrations", "disk", "blobs", "event_loop")
    }


def test_version_route_returns_the_installed_version(admin):
    answer = admin.get("/version").json()

    assert (answer["version"], answer["api"]) == (version("unghost"), "v1")
