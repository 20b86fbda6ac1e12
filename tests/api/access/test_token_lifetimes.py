"""Expiry and last use of tokens, and the first token, kept in the data folder."""

import stat
from datetime import datetime, timedelta, timezone

import pytest

from app.access.gate import write_upkeep
from tests.support.databases import everything_in
from tests.support.live import live

TOKENS = "/api/v1/tokens"
DAY = timedelta(days=1)


def now():
    return datetime.now(timezone.utc)


def create(client, name, **body):
    response = client.post(TOKENS, json={"name": name, **body})
    assert response.status_code == 201, response.text
    return response.json()


def parse_time(text):
    return None if text is None else datetime.fromisoformat(text)


def token_named(client, name):
    items = client.get(TOKENS, params={"limit": 1000}).json()["items"]
    return next(item for item in items if item["name"] == name)


def is_authenticated(service, token):
    with service.client(Authorization=f"Bearer {token}") as client:
        return client.get("/version").status_code == 200


def test_token_lasts_until_it_is_revoked_or_as_requested(admin):
    for name in ("expires_at", "expires_in_days", "role"):
        body = {name: "viewer" if name == "role" else None}
        assert create(admin, f"lasting by {name}", **body)["expires_at"] is None

    week = create(admin, "lasting a week", expires_in_days=7)

    assert 7 * DAY - DAY / 24 < parse_time(week["expires_at"]) - now() <= 7 * DAY


def test_invalid_expiry_is_refused(admin):
    for days in (0, 36_501, "a week"):
        response = admin.post(TOKENS, json={"name": "odd", "expires_in_days": days})
        (fault,) = response.json()["errors"]
        assert (response.status_code, fault["pointer"]) == (422, "/expires_in_days")

    ends = {"expires_at": (now() + DAY).isoformat(), "expires_in_days": 7}
    both = admin.post(TOKENS, json={"name": "twice", **ends})

    assert both.status_code == 422
    assert "expected either expires_at or expires_in_days" in both.json()["detail"]


def test_last_use_of_a_token_is_written_by_upkeep_not_by_requests(service, admin):
    made = create(admin, "worker")
    with service.client(Authorization=f"Bearer {made['token']}") as worker:
        write_upkeep(service.app.state.services)
        before = everything_in(service.settings.data)
        begun = now()
        for _ in range(3):
            assert worker.get("/version").status_code == 200

    assert everything_in(service.settings.data) == before
    assert token_named(admin, "worker")["last_used_at"] is None
    write_upkeep(service.app.state.services)
    assert begun <= parse_time(token_named(admin, "worker")["last_used_at"]) <= now()
    write_upkeep(service.app.state.services)
    noted = everything_in(service.settings.data)
    write_upkeep(service.app.state.services)
    assert everything_in(service.settings.data) == noted


def test_the_last_use_of_a_token_is_written_when_the_service_stops(tmp_path):
    with live(tmp_path / "data") as first:
        with first.admin() as admin:
            made = create(admin, "last")
        assert is_authenticated(first, made["token"])

    with live(tmp_path / "data") as second, second.admin() as admin:
        assert token_named(admin, "last")["last_used_at"] is not None


def test_a_session_counts_as_a_use_of_its_token(service, admin):
    made = create(admin, "browser")
    with service.client() as page:
        opened = page.post("/api/v1/session", json={"token": made["token"]})

    write_upkeep(service.app.state.services)

    assert opened.status_code == 201
    assert token_named(admin, "browser")["last_used_at"] is not None


def test_token_file_that_is_a_link_is_replaced_and_its_target_stays(serve, tmp_path):
    before = serve()
    file, target = before.settings.token_file, tmp_path / "elsewhere"
    old = file.read_text()
    file.rename(target)
    target.chmod(0o644)
    file.symlink_to(target)

    after = serve()

    assert not file.is_symlink()
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert after.token != old
    assert (target.read_text(), stat.S_IMODE(target.stat().st_mode)) == (old, 0o644)


@pytest.mark.parametrize("mode", [0o640, 0o604, None])
def test_token_file_that_was_deleted_or_is_readable_by_others_gets_a_new_token(
    serve, caplog, mode
):
    before = serve()
    old = before.token
    with before.client() as page, before.admin() as admin:
        opened = page.post("/api/v1/session", json={"token": old}).json()
        code = admin.post("/api/v1/login-codes").json()["code"]
    if mode is None:
        before.settings.token_file.unlink()
    else:
        before.settings.token_file.chmod(mode)

    after = serve()

    assert stat.S_IMODE(after.settings.token_file.stat().st_mode) == 0o600
    assert after.token != old
    assert is_authenticated(after, after.token)
    assert not is_authenticated(after, old)
    assert not is_authenticated(after, opened["session"])
    with after.client() as page:
        by_code = page.post("/api/v1/session", json={"code": code})
    assert (by_code.status_code, by_code.json()["code"]) == (401, "code_over")
    if mode is not None:
        warning = f"the token file could be read by others (mode {mode:o})"
        assert warning in caplog.text
    assert after.token not in caplog.text
