"""The routes that say whether the service is alive and ready, and its version."""

from importlib.metadata import version

from tests.support.waiting import until


def test_healthz_and_readyz_of_a_running_service_are_ok(anonymous):
    # A service that the machine has just stopped for a second says so for a moment.
    until(lambda: anonymous.get("/readyz").is_success)
    ready = anonymous.get("/readyz").json()

    assert anonymous.get("/healthz").json() == {"status": "ok"}
    assert ready["ready"] is True
    assert set(ready["checks"]) == {
        *("database", "pages", "migrations", "disk", "blobs", "background"),
        "event_loop",
    }


def test_version_route_returns_the_installed_version(admin):
    body = admin.get("/version").json()

    assert (body["version"], body["api"]) == (version("unghost"), "v1")
