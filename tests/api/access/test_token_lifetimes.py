"""Expiry and last use of tokens, and the first token, kept in the data folder."""

from __future__ import annotations

import stat
from datetime import datetime, timedelta, timezone

import pytest

from app.access.first_token import LIFETIME, RENEWED_BEFORE
from app.access.service import MOST_SESSIONS
from app.access.upkeep import write_upkeep
from app.db.tables.access import Token
from tests.support.databases import everything_in
from tests.support.live import live

TOKENS = "/api/v1/tokens"
DAY = timedelta(days=1)


def now():
    return datetime.now(timezone.utc)


def create(client, name, **body):
    answer = client.post(TOKENS, json={"name": name, **body})
    assert answer.status_code == 201, answer.text
    return answer.json()


def time_of(text):
    return None if text is None else datetime.fromisoformat(text)


def listed(client, name):
    items = client.get(TOKENS, params={"limit": 1000}).json()["items"]
    return next(item for item in items if item["name"] == name)


def first_ends(service, at):
    """Set when the first token expires, as if time had passed."""
    with service.app.state.database.write() as session:
        session.get(Token, 1).expires_at = at


def opens(service, token):
    with service.client(Authorization=f"Bearer {token}") as client:
        return client.get("/version").status_code == 200


@pytest.mark.parametrize(
    ("body", "days"),
    [
        ({}, 90),
        ({"expires_at": None}, 90),
        ({"expires_in_days": 7}, 7),
        ({"expires_in_days": None}, None),
    ],
)
def test_a_token_ends_after_ninety_days_unless_somebody_says_otherwise(
    admin, body, days
):
    made = create(admin, f"lasting-{body}", **body)

    ends = time_of(made["expires_at"])
    if days is None:
        assert ends is None
    else:
        assert days * DAY - DAY / 24 < ends - now() <= days * DAY


@pytest.mark.parametrize("days", [0, -1, 36_501, "a week", 1.5])
def test_days_that_are_none_are_refused(admin, days):
    answer = admin.post(TOKENS, json={"name": "odd", "expires_in_days": days})

    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"] == "/expires_in_days"


def test_an_end_is_said_once(admin):
    ends = {"expires_at": (now() + DAY).isoformat(), "expires_in_days": 7}

    answer = admin.post(TOKENS, json={"name": "twice", **ends})

    assert answer.status_code == 422
    assert "expected either expires_at or expires_in_days" in answer.json()["detail"]


def test_the_last_use_of_a_token_is_noted_by_the_service_and_by_no_request(
    service, admin
):
    made = create(admin, "worker")
    with service.client(Authorization=f"Bearer {made['token']}") as worker:
        write_upkeep(service.app.state.services)
        before = everything_in(service.settings.data)
        begun = now()
        for _ in range(3):
            assert worker.get("/version").status_code == 200

    assert everything_in(service.settings.data) == before
    assert listed(admin, "worker")["last_used_at"] is None
    write_upkeep(service.app.state.services)
    assert begun <= time_of(listed(admin, "worker")["last_used_at"]) <= now()
    write_upkeep(service.app.state.services)
    noted = everything_in(service.settings.data)
    write_upkeep(service.app.state.services)
    assert everything_in(service.settings.data) == noted


def test_the_last_use_of_a_token_is_written_when_the_service_stops(tmp_path):
    with live(tmp_path / "data") as first:
        with first.admin() as admin:
            made = create(admin, "last")
        assert opens(first, made["token"])

    with live(tmp_path / "data") as second, second.admin() as admin:
        assert listed(admin, "last")["last_used_at"] is not None


def test_a_session_counts_as_a_use_of_its_token(service, admin):
    made = create(admin, "browser")
    with service.client() as page:
        opened = page.post("/api/v1/session", json={"token": made["token"]})

    write_upkeep(service.app.state.services)

    assert opened.status_code == 201
    assert listed(admin, "browser")["last_used_at"] is not None


def test_the_first_token_ends_after_a_month(serve):
    service = serve()
    with service.admin() as admin:
        ends = time_of(listed(admin, "admin")["expires_at"])

    assert LIFETIME - DAY / 24 < ends - now() <= LIFETIME == 30 * DAY


def test_a_first_token_without_an_end_gets_one_at_the_next_start(serve):
    """The first tokens of earlier versions have no end."""
    before = serve()
    old = before.token
    first_ends(before, None)

    after = serve()

    assert after.token != old
    assert opens(after, old)
    with after.admin() as admin:
        assert time_of(listed(admin, "admin")["expires_at"]) is not None


def test_the_first_token_is_renewed_while_the_service_runs(serve):
    service = serve()
    old, soon = service.token, now() + RENEWED_BEFORE - DAY
    with service.client() as page:
        opened = page.post("/api/v1/session", json={"token": old}).json()
    write_upkeep(service.app.state.services)
    assert service.token == old
    first_ends(service, soon)

    write_upkeep(service.app.state.services)

    assert service.token != old
    mode = stat.S_IMODE(service.settings.token_file.stat().st_mode)
    assert mode == 0o600
    # The old token goes on working, and so do the sessions opened with it.
    assert opens(service, service.token)
    assert opens(service, old)
    assert opens(service, opened["session"])
    with service.admin() as admin:
        assert time_of(listed(admin, "admin")["expires_at"]) > now() + LIFETIME - DAY
        newest = admin.get("/api/v1/audit").json()["items"][0]
        assert (newest["actor"], newest["action"]) == ("unghost", "token.renewed")
        # Revoking it ends its old value, too, and the sessions opened with that.
        create(admin, "another", role="admin", expires_in_days=None)
        admin.delete(f"{TOKENS}/1")
    assert not opens(service, old)
    assert not opens(service, opened["session"])


def test_no_number_of_sessions_ends_a_first_token_that_was_renewed(serve):
    service = serve()
    old = service.token
    first_ends(service, now() + DAY)
    write_upkeep(service.app.state.services)

    with service.client() as page:
        for _ in range(MOST_SESSIONS + 1):
            page.post("/api/v1/session", json={"token": service.token})

    assert opens(service, old)


def test_a_token_file_that_is_gone_is_not_made_anew_by_the_service_that_runs(serve):
    service = serve()
    first_ends(service, now() + DAY)
    service.settings.token_file.unlink()

    write_upkeep(service.app.state.services)

    assert not service.settings.token_file.exists()


@pytest.mark.parametrize("mode", [0o644, 0o640, 0o604])
def test_a_token_that_others_could_read_is_replaced_and_its_file_mended(
    serve, caplog, mode
):
    before = serve()
    old = before.token
    with before.client() as page:
        opened = page.post("/api/v1/session", json={"token": old}).json()
    before.settings.token_file.chmod(mode)

    after = serve()

    assert stat.S_IMODE(after.settings.token_file.stat().st_mode) == 0o600
    assert after.token != old
    assert opens(after, after.token)
    assert not opens(after, old)
    assert not opens(after, opened["session"])
    assert f"others could read the token file (mode {mode:o})" in caplog.text
    assert after.token not in caplog.text
