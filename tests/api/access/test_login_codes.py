"""The codes of login links: each opens one session, within ten minutes."""

from concurrent.futures import ThreadPoolExecutor
from datetime import datetime, timedelta, timezone

import pytest
from sqlalchemy import func, select

from app.access.service import MOST_CODES, MOST_SESSIONS
from app.db.tables.access import LoginCode, LoginSession
from app.security import hash_secret
from tests.support import plain_http
from tests.support.databases import everything_in


def log_in(service, client, **body):
    """Log in with this body or the token; return the header of the new session."""
    response = client.post("/api/v1/session", json=body or {"token": service.token})
    assert response.status_code == 201, response.text
    return {"Authorization": f"Bearer {response.json()['session']}"}


def test_login_code_is_single_use_and_opens_a_session_of_its_token(
    service, admin, anonymous, as_role
):
    made = admin.post("/api/v1/login-codes")
    code, path = made.json()["code"], f"/api/v1/login-codes/{made.json()['id']}"
    before = admin.get(path).json()

    session = log_in(service, anonymous, code=code)
    again = anonymous.post("/api/v1/session", json={"code": code})

    after = admin.get(path).json()
    assert made.headers["cache-control"] == "no-store"
    assert anonymous.get("/api/v1/session", headers=session).json()["name"] == "admin"
    assert (again.status_code, again.json()["code"]) == (401, "code_over")
    assert before["used_at"] is None
    assert after["used_at"] is not None
    assert "code" not in after
    assert code not in everything_in(service.settings.data)
    assert as_role("admin").get(path).status_code == 404, "a code of another token"


def test_login_code_used_concurrently_opens_one_session(service, admin):
    code = admin.post("/api/v1/login-codes").json()["code"]

    def use(_):
        return plain_http.post(f"{service.url}/api/v1/session", json={"code": code})

    with ThreadPoolExecutor(8) as people:
        responses = list(people.map(use, range(8)))

    assert sorted(response.status_code for response in responses) == [201, *[401] * 7]


def test_login_code_expires_after_ten_minutes(service, admin, anonymous):
    made = admin.post("/api/v1/login-codes").json()
    ends = datetime.fromisoformat(made["expires_at"])
    now = datetime.now(timezone.utc)
    assert timedelta(minutes=9) < ends - now <= timedelta(minutes=10)

    with service.app.state.database.write() as session:
        stored = select(LoginCode).where(LoginCode.hash == hash_secret(made["code"]))
        session.scalars(stored).one().expires_at = now

    response = anonymous.post("/api/v1/session", json={"code": made["code"]})
    assert (response.status_code, response.json()["code"]) == (401, "code_over")
    assert "`unghost login` prints a new one" in response.json()["detail"]


def test_login_code_of_a_revoked_token_is_unauthorised(admin, anonymous):
    token = admin.post("/api/v1/tokens", json={"name": "leaver"}).json()
    bearer = {"Authorization": f"Bearer {token['token']}"}
    code = anonymous.post("/api/v1/login-codes", headers=bearer).json()["code"]

    admin.delete(f"/api/v1/tokens/{token['id']}")

    response = anonymous.post("/api/v1/session", json={"code": code})
    assert response.status_code == 401


def test_login_code_needs_the_token_itself_and_login_one_of_both(service, anonymous):
    """A session would open another session, which the end of it does not end."""
    session = log_in(service, anonymous)

    response = anonymous.post("/api/v1/login-codes", headers=session)

    assert response.status_code == 403
    assert "a login code needs the token itself" in response.json()["detail"]
    for body in ({}, {"token": "ug_x", "code": "uc_x"}):
        response = anonymous.post("/api/v1/session", json=body)
        assert response.status_code == 422
        assert "expected either token or code" in response.json()["detail"]


def test_login_codes_and_logins_are_audited(service, admin, anonymous):
    code = admin.post("/api/v1/login-codes").json()["code"]
    log_in(service, anonymous, code=code)
    log_in(service, anonymous)

    entries = admin.get("/api/v1/audit").json()["items"][:3]

    acts = [(entry["actor"], entry["action"], entry["details"]) for entry in entries]
    assert acts == [
        ("admin", "session.opened", {"by": "token"}),
        ("admin", "session.opened", {"by": "code"}),
        ("admin", "login_code.created", {}),
    ]


@pytest.fixture
def client_and_token(service, admin, request):
    """A client with a new token, and the answer that the token came in."""
    made = admin.post("/api/v1/tokens", json={"name": request.node.name})
    shown = {"Authorization": f"Bearer {made.json()['token']}"}
    with service.client(**shown) as client:
        yield client, made.json()


def count_rows(service, table, token_id):
    counted = select(func.count()).select_from(table).where(table.token_id == token_id)
    with service.app.state.database.read() as session:
        return session.scalar(counted)


def test_oldest_login_codes_of_a_token_are_deleted_over_the_limit(
    service, admin, anonymous, client_and_token
):
    busy, token = client_and_token
    others = admin.post("/api/v1/login-codes").json()["code"]

    codes = [busy.post("/api/v1/login-codes").json() for _ in range(MOST_CODES + 2)]

    assert count_rows(service, LoginCode, token["id"]) == MOST_CODES
    for made in codes[:2]:
        response = anonymous.post("/api/v1/session", json={"code": made["code"]})
        assert (response.status_code, response.json()["code"]) == (401, "code_over")
        assert busy.get(f"/api/v1/login-codes/{made['id']}").status_code == 404
    for code in (codes[2]["code"], codes[-1]["code"], others):
        log_in(service, anonymous, code=code)


def test_oldest_sessions_of_a_token_are_deleted_over_the_limit(
    service, admin, anonymous, client_and_token
):
    _, token = client_and_token
    others = log_in(service, anonymous)

    sessions = [
        log_in(service, anonymous, token=token["token"])
        for _ in range(MOST_SESSIONS + 2)
    ]

    assert count_rows(service, LoginSession, token["id"]) == MOST_SESSIONS
    statuses = [
        anonymous.get("/api/v1/session", headers=session).status_code
        for session in sessions
    ]
    assert statuses == [401] * 2 + [200] * MOST_SESSIONS
    assert anonymous.get("/api/v1/session", headers=others).status_code == 200
