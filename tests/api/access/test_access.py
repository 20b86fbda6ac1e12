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


def test_login_refuses_wrong_tokens_sessions_and_other_origins(service, anonymous):
    session = log_in(service, anonymous)["Authorization"].removeprefix("Bearer ")
    elsewhere = {"Origin": "http://evil.example"}

    wrong, of_session, of_others = (
        anonymous.post("/api/v1/session", json={"token": token}, headers=headers)
        for token, headers in (
            *(("ug_x", {}), (session, {})),
            (service.token, elsewhere),
        )
    )

    assert (wrong.status_code, wrong.json()["detail"]) == (401, WRONG_TOKEN)
    assert of_session.status_code == 401
    assert (of_others.status_code, "session" in of_others.json()) == (403, False)


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


def test_login_sets_no_cookie_and_its_secret_is_neither_cached_nor_stored(
    service, anonymous
):
    key = {"Idempotency-Key": "log-in"}

    response, again = (
        anonymous.post("/api/v1/session", json={"token": service.token}, headers=key)
        for _ in range(2)
    )

    assert "set-cookie" not in response.headers
    assert response.headers["cache-control"] == "no-store"
    session = response.json()
    assert session == {
        "session": session["session"],
        "expires_at": session["expires_at"],
        "name": "admin",
        "role": "admin",
    }
    assert session["session"].startswith("us_")
    assert service.token not in response.text
    dump = everything_in(service.settings.data)
    assert session["session"] != again.json()["session"]
    assert session["session"] not in dump
    assert again.json()["session"] not in dump


def test_token_and_session_stay_valid_after_a_restart(serve):
    first = serve()
    with first.client() as browser:
        session = log_in(first, browser)

    second = serve()

    assert second.token == first.token
    with second.client(**session) as browser:
        assert browser.get("/version").status_code == 200


def test_session_writes_only_from_the_page_of_its_service(service, anonymous):
    """A write with a session is refused if its headers name another page.

    Other pages do not have the session. Should one get it, the browser still sends
    these headers, which give it away.
    """
    session = log_in(service, anonymous)
    others = [
        *({"Origin": origin} for origin in ("http://evil.example", "null")),
        {"Origin": "http://127.0.0.1:1"},
        *({"Sec-Fetch-Site": site} for site in ("same-site", "cross-site")),
        {"Origin": "http://evil.example", "Sec-Fetch-Site": "same-origin"},
    ]

    for headers in others:
        response = anonymous.post("/probe/echo", headers={**session, **headers})
        refusal = (response.status_code, response.json().get("code"))
        assert refusal == (403, "forbidden"), headers
    for headers in ({"Origin": service.url}, {"Sec-Fetch-Site": "same-origin"}):
        response = anonymous.post("/probe/echo", headers={**session, **headers})
        assert response.status_code == 200, headers
