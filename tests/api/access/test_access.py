"""Authentication: tokens, sessions, roles, and requests from other web pages."""

import stat

import pytest

from tests.support.databases import everything_in

OPEN = {
    ("get", "/healthz"),
    ("get", "/readyz"),
    ("post", "/api/v1/session"),
    ("get", "/api/v1/exports/{export_id}/file"),
    ("get", "/open/hello"),
    ("get", "/open/wait"),
}
WRONG_TOKEN = "the token that was sent is not accepted: this server does not know it"
METHODS = ("get", "post", "put", "patch", "delete")


def operations(schema):
    return [
        (method, path)
        for path, operations in schema["paths"].items()
        for method in METHODS
        if method in operations
    ]


def log_in(service, client):
    """Log in; return the header that shows the new session."""
    response = client.post("/api/v1/session", json={"token": service.token})
    assert response.status_code == 201, response.text
    return {"Authorization": f"Bearer {response.json()['session']}"}


def own_origin(service):
    return {"Origin": service.url}


def test_openapi_document_marks_the_open_routes(admin):
    schema = admin.get("/openapi.json").json()

    undefended = {
        (method, path)
        for method, path in operations(schema)
        if "security" not in schema["paths"][path][method]
    }
    assert undefended == OPEN


@pytest.mark.parametrize(
    ("header", "detail"),
    [
        ("Bearer ug_x", WRONG_TOKEN),
        (
            "Bearer us_x",
            "the session that was sent is not accepted: it has ended, or is another "
            "server's",
        ),
        ("Bearer", "a valid token or session is required"),
        ("Basic dWc6", "a valid token or session is required"),
        (None, "a token is required: Authorization: Bearer ug_..."),
    ],
)
def test_error_says_whether_a_wrong_token_or_none_was_sent(anonymous, header, detail):
    headers = {} if header is None else {"Authorization": header}

    response = anonymous.get("/version", headers=headers)

    assert (response.status_code, response.json()["detail"]) == (401, detail)


def test_wrong_token_at_login_is_not_called_missing(anonymous):
    response = anonymous.post("/api/v1/session", json={"token": "ug_x"})

    assert response.status_code == 401
    assert response.json()["detail"] == WRONG_TOKEN


def test_token_is_in_its_private_file_alone(service):
    mode = stat.S_IMODE(service.settings.token_file.stat().st_mode)
    folder = stat.S_IMODE(service.settings.data.stat().st_mode)
    dump = everything_in(service.settings.data)

    assert (mode, folder) == (0o600, 0o700)
    assert service.token.startswith("ug_")
    assert len(service.token) == 46
    assert service.token not in dump
    files = (path for path in service.settings.data.rglob("*") if path.is_file())
    secret = service.token.encode()
    assert [path.name for path in files if secret in path.read_bytes()] == ["token"]


def test_deleting_the_token_file_changes_token_and_ends_sessions(serve):
    before = serve()
    old = before.token
    with before.client() as browser:
        session = log_in(before, browser)
    before.settings.token_file.unlink()

    after = serve()

    with after.client() as client:
        by_token = client.get("/version", headers={"Authorization": f"Bearer {old}"})
        by_session = client.get("/version", headers=session)
    assert after.token != old
    assert (by_token.status_code, by_session.status_code) == (401, 401)


def test_login_sets_no_cookie_and_its_response_is_not_cached(service, anonymous):
    response = anonymous.post("/api/v1/session", json={"token": service.token})

    assert "set-cookie" not in response.headers
    assert response.headers["cache-control"] == "no-store"
    assert response.json() == {
        "session": response.json()["session"],
        "name": "admin",
        "role": "admin",
        "expires_at": response.json()["expires_at"],
    }
    assert response.json()["session"].startswith("us_")
    assert service.token not in response.text


def test_login_with_idempotency_key_stores_no_session_secret(service, anonymous):
    headers = {"Idempotency-Key": "log-in"}

    sessions = {
        anonymous.post(
            "/api/v1/session", json={"token": service.token}, headers=headers
        ).json()["session"]
        for _ in range(2)
    }

    assert len(sessions) == 2
    assert all(
        session not in everything_in(service.settings.data) for session in sessions
    )


def test_token_and_session_stay_valid_after_a_restart(serve):
    first = serve()
    with first.client() as browser:
        session = log_in(first, browser)

    second = serve()

    assert second.token == first.token
    with second.client(**session) as browser:
        assert browser.get("/version").status_code == 200


def test_session_opens_no_other_session(service, anonymous):
    session = log_in(service, anonymous)
    secret = session["Authorization"].removeprefix("Bearer ")

    response = anonymous.post("/api/v1/session", json={"token": secret})

    assert response.status_code == 401


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Sec-Fetch-Site": "same-site"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Origin": "http://evil.example", "Sec-Fetch-Site": "same-origin"},
    ],
)
def test_session_write_from_another_origin_is_forbidden(service, anonymous, headers):
    """A write with a session is refused if its headers name another page.

    Other pages do not have the session. Should one get it, the browser still sends
    these headers, which give it away.
    """
    session = log_in(service, anonymous)

    response = anonymous.post("/probe/echo", headers={**session, **headers})

    assert (response.status_code, response.json()["code"]) == (403, "forbidden")


def test_session_write_from_its_own_origin_is_allowed(service, anonymous):
    session = log_in(service, anonymous)
    same = {"Sec-Fetch-Site": "same-origin"}

    by_origin = anonymous.post(
        "/probe/echo", headers={**session, **own_origin(service)}
    )
    by_site = anonymous.post("/probe/echo", headers={**session, **same})

    assert (by_origin.status_code, by_site.status_code) == (200, 200)


def test_login_from_another_origin_is_forbidden(service, anonymous):
    response = anonymous.post(
        "/api/v1/session",
        json={"token": service.token},
        headers={"Origin": "http://evil.example"},
    )

    assert response.status_code == 403
    assert "session" not in response.json()
