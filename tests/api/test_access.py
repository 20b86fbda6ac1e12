"""Who may come in: tokens, sessions, roles, and pages of other places."""

from __future__ import annotations

import re
import stat

import pytest

from app.security import Role
from tests.databases import everything_in

OPEN = {
    ("get", "/healthz"),
    ("get", "/readyz"),
    ("post", "/api/v1/session"),
    ("get", "/open/hello"),
}
METHODS = ("get", "post", "put", "patch", "delete")


def operations(schema):
    return [
        (method, path)
        for path, operations in schema["paths"].items()
        for method in METHODS
        if method in operations
    ]


def log_in(service, client):
    answer = client.post("/api/v1/session", json={"token": service.token})
    assert answer.status_code == 204
    return answer


def own_origin(service):
    return {"Origin": service.url}


@pytest.mark.parametrize("credentials", [{}, {"Authorization": "Bearer ug_wrong"}])
def test_every_route_but_the_open_ones_wants_a_token(service, admin, credentials):
    schema = admin.get("/openapi.json").json()

    with service.client(**credentials) as client:
        let_in = {
            (method, path)
            for method, path in operations(schema)
            if client.request(method, re.sub(r"{.*?}", "1", path)).status_code != 401
        }

    assert let_in == OPEN


def test_the_document_says_which_routes_are_open(admin):
    schema = admin.get("/openapi.json").json()

    undefended = {
        (method, path)
        for method, path in operations(schema)
        if "security" not in schema["paths"][path][method]
    }
    assert undefended == OPEN


def test_even_the_description_wants_a_token(anybody):
    paths = ("/openapi.json", "/docs", "/docs/style.css", "/version")

    assert {anybody.get(path).status_code for path in paths} == {401}


@pytest.mark.parametrize(
    "header",
    ["", "Bearer", "Basic dWc6", "Bearer ug_", "bearer x y", "ug_x"],
)
def test_anything_but_a_valid_token_is_401(anybody, header):
    answer = anybody.get("/version", headers={"Authorization": header})

    assert (answer.status_code, answer.json()["code"]) == (401, "unauthorised")
    assert answer.headers["www-authenticate"].startswith("Bearer")


@pytest.mark.parametrize(
    ("role", "expected"),
    [
        (Role.VIEWER, (200, 403, 403)),
        (Role.REVIEWER, (200, 200, 403)),
        (Role.ADMIN, (200, 200, 200)),
    ],
)
def test_a_role_may_do_what_it_may_do(as_role, role, expected):
    client = as_role(role)

    answers = (
        client.get("/version"),
        client.post("/probe/echo"),
        client.post("/probe/admin-only"),
    )

    assert tuple(answer.status_code for answer in answers) == expected


def test_the_token_is_for_its_owner_alone_and_not_in_the_database(service):
    mode = stat.S_IMODE(service.settings.token_file.stat().st_mode)
    folder = stat.S_IMODE(service.settings.data.stat().st_mode)
    dump = everything_in(service.settings.data)

    assert (mode, folder) == (0o600, 0o700)
    assert service.token.startswith("ug_")
    assert len(service.token) == 46
    assert service.token not in dump


def test_no_file_of_the_data_folder_holds_the_token_but_one(service):
    secret = service.token.encode()

    holders = [
        path.name
        for path in service.settings.data.rglob("*")
        if path.is_file() and secret in path.read_bytes()
    ]

    assert holders == ["token"]


def test_a_restart_keeps_the_token(serve):
    assert serve().token == serve().token


def test_deleting_the_file_changes_the_token_and_ends_its_sessions(serve):
    before = serve()
    old = before.token
    with before.client() as browser:
        log_in(before, browser)
        cookie = browser.cookies["unghost_session"]
    before.settings.token_file.unlink()

    after = serve()

    with after.client() as client:
        by_token = client.get("/version", headers={"Authorization": f"Bearer {old}"})
        client.cookies.set("unghost_session", cookie)
        by_cookie = client.get("/version")
    assert after.token != old
    assert (by_token.status_code, by_cookie.status_code) == (401, 401)


def test_the_cookie_is_out_of_reach_of_scripts_and_other_sites(service, anybody):
    cookie = log_in(service, anybody).headers["set-cookie"]

    name, *attributes = (part.strip() for part in cookie.split(";"))
    assert name.startswith("unghost_session=")
    assert service.token not in name
    assert {part.lower() for part in attributes if "expires" not in part.lower()} == {
        *("httponly", "samesite=strict", "path=/", "max-age=2592000")
    }


@pytest.mark.parametrize("proxies", [(), ("127.0.0.0/8",), ("192.0.2.1",)])
def test_the_cookie_is_for_tls_only_where_a_trusted_proxy_says_so(serve, proxies):
    service = serve(trusted_proxies=proxies)
    with service.client(**{"X-Forwarded-Proto": "https"}) as browser:
        cookie = log_in(service, browser).headers["set-cookie"]

    assert ("secure" in cookie.lower()) == (proxies == ("127.0.0.0/8",))


def test_a_session_reads_and_outlives_a_restart(serve):
    first = serve()
    with first.client() as browser:
        log_in(first, browser)
        cookie = browser.cookies["unghost_session"]

    second = serve()

    with second.client(Cookie=f"unghost_session={cookie}") as browser:
        assert browser.get("/version").status_code == 200


def test_a_wrong_token_opens_no_session(anybody):
    answer = anybody.post("/api/v1/session", json={"token": "ug_guess"})

    assert answer.status_code == 401
    assert "set-cookie" not in answer.headers


def test_logging_out_ends_the_session(service, anybody):
    log_in(service, anybody)
    cookie = anybody.cookies["unghost_session"]

    answer = anybody.delete("/api/v1/session", headers=own_origin(service))

    with service.client(Cookie=f"unghost_session={cookie}") as thief:
        assert (answer.status_code, thief.get("/version").status_code) == (204, 401)


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Sec-Fetch-Site": "same-site"},
        {"Sec-Fetch-Site": "cross-site"},
    ],
)
def test_a_session_does_not_write_for_other_pages(service, anybody, headers):
    log_in(service, anybody)

    answer = anybody.post("/probe/echo", headers=headers)

    assert (answer.status_code, answer.json()["code"]) == (403, "forbidden")


def test_a_foreign_origin_is_refused_even_if_the_browser_says_same_origin(
    service, anybody
):
    log_in(service, anybody)

    answer = anybody.post(
        "/probe/echo",
        headers={"Origin": "http://evil.example", "Sec-Fetch-Site": "same-origin"},
    )

    assert answer.status_code == 403


def test_a_session_writes_for_its_own_page(service, anybody):
    log_in(service, anybody)

    by_origin = anybody.post("/probe/echo", headers=own_origin(service))
    by_site = anybody.post("/probe/echo", headers={"Sec-Fetch-Site": "same-origin"})

    assert (by_origin.status_code, by_site.status_code) == (200, 200)


def test_a_program_with_a_token_needs_no_origin(admin):
    assert admin.post("/probe/echo").status_code == 200


def test_another_page_cannot_log_a_browser_in(service, anybody):
    answer = anybody.post(
        "/api/v1/session",
        json={"token": service.token},
        headers={"Origin": "http://evil.example"},
    )

    assert answer.status_code == 403
    assert "set-cookie" not in answer.headers


def test_a_token_that_is_shown_is_what_counts(service, anybody):
    """A wrong token is not made good by a cookie."""
    log_in(service, anybody)

    answer = anybody.get("/version", headers={"Authorization": "Bearer ug_wrong"})

    assert answer.status_code == 401
