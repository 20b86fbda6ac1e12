"""Every route with every role and with invalid tokens: what is allowed and refused."""

import re
from datetime import datetime, timedelta, timezone
from itertools import count
from typing import get_args

import pytest

from app.db.tables.access import Token
from app.http.routing import ApiRoute, OpenRoute
from app.security import includes
from tests.support.routes import (
    NO_ROLE,
    REQUIRED_ROLES,
    every_route,
    fill_path,
    operations,
)
from unghost.wire.words import Role

# An id that no token has: an admin must not revoke the token that the test uses.
MISSING_ID = "1000000000"
NEEDING_A_ROLE = {
    route: role for route, role in REQUIRED_ROLES.items() if role is not NO_ROLE
}
UNAUTHORISED = {401}
REFUSALS = {401, 403, 429}
_numbers = count(1)


@pytest.fixture(scope="module")
def path_values(path_values):
    """Values for the paths of all routes to a dataset of an admin."""
    ids = dict.fromkeys(("token_id", "batch_id", "revision"), 1)
    return {**path_values, **ids, "name:any": "car"}


def statuses_of(client, values, operations=NEEDING_A_ROLE):
    """The status of each operation, requested with nothing but its path."""
    return {
        (method, path): client.request(method, fill_path(path, values)).status_code
        for method, path in sorted(operations)
    }


def test_every_route_has_a_declared_role():
    """A new route must be added to `REQUIRED_ROLES`, with the role that it needs."""
    served = {operation for route in every_route() for operation in operations(route)}

    assert served - REQUIRED_ROLES.keys() == set()
    assert REQUIRED_ROLES.keys() - served == set()


def test_every_route_names_its_role_in_its_signature():
    declared = {}
    for route in every_route():
        for method, path in operations(route):
            needed = getattr(route, "role", NO_ROLE)
            declared[method, path] = needed
            is_open = needed is NO_ROLE
            # Only the page takes any query: its views keep their filters there.
            assert isinstance(route, OpenRoute if is_open else ApiRoute) or path == "/"

    assert declared == {route: REQUIRED_ROLES[route] for route in declared}


@pytest.mark.parametrize("role", get_args(Role))
def test_role_is_allowed_its_routes_and_forbidden_all_others(as_role, role):
    """The ids in the paths do not exist: allowed requests may get a 404, but no 403."""
    names = re.findall(r"{(.*?)}", " ".join(path for _, path in NEEDING_A_ROLE))
    nowhere = dict.fromkeys(names, MISSING_ID)
    client = as_role(role)

    statuses = statuses_of(client, nowhere)

    refused = {route for route, status in statuses.items() if status in REFUSALS}
    barred = {
        route for route, needed in NEEDING_A_ROLE.items() if not includes(role, needed)
    }
    assert refused == barred
    assert {statuses[route] for route in refused} <= {403}


@pytest.mark.parametrize("role", ["viewer", "reviewer"])
def test_role_is_forbidden_on_a_dataset_of_others_and_changes_nothing(
    service, as_role, path_values, role
):
    """The paths lead to a real dataset, which a refused request must not change."""
    barred = {
        route for route, needed in NEEDING_A_ROLE.items() if not includes(role, needed)
    }
    with service.admin() as admin:
        before = admin.get("/api/v1/datasets/street").json()

        statuses = statuses_of(as_role(role), path_values, barred)

        assert set(statuses.values()) == {403}
        assert admin.get("/api/v1/datasets/street").json() == before
        assert admin.get("/version").status_code == 200


def test_a_viewer_may_read_datasets_of_others(as_role, path_values):
    reading = {route for route, role in NEEDING_A_ROLE.items() if role == "viewer"}
    gets = {route for route in reading if route[0] == "GET"}

    statuses = statuses_of(as_role("viewer"), path_values, gets)

    assert {route for route, status in statuses.items() if status in REFUSALS} == set()
    assert statuses["GET", "/api/v1/boxes/{box_id}"] == 200
    assert statuses["GET", "/api/v1/frames/{frame_id}/{kind}"] == 200


def new_token(client):
    name = f"token-{next(_numbers)}"
    return client.post("/api/v1/tokens", json={"name": name}).json()


def expire(service, token):
    with service.app.state.database.write() as session:
        row = session.get(Token, token["id"])
        row.expires_at = datetime.now(timezone.utc) - timedelta(seconds=1)


def expired(service, client):
    token = new_token(client)
    expire(service, token)
    return {"Authorization": f"Bearer {token['token']}"}


def revoked(service, client):
    token = new_token(client)
    client.delete(f"/api/v1/tokens/{token['id']}")
    return {"Authorization": f"Bearer {token['token']}"}


def ended_session(service, client):
    """The session of a browser that has logged out."""
    session = open_session(service, service.token)
    with service.client(**session) as browser:
        assert browser.delete("/api/v1/session").status_code == 204
    return session


def session_as_a_cookie(service, client):
    """A valid session, but in a cookie, as earlier versions took it."""
    secret = open_session(service, service.token)["Authorization"].split()[1]
    return {"Cookie": f"unghost_session={secret}", "Origin": service.url}


def open_session(service, token):
    with service.client(Origin=service.url) as browser:
        opened = browser.post("/api/v1/session", json={"token": token})
    return {"Authorization": f"Bearer {opened.json()['session']}"}


INVALID_CREDENTIALS = {
    "missing": lambda service, client: {},
    "another scheme": lambda service, client: {"Authorization": "Basic dWc6"},
    "garbage": lambda service, client: {"Authorization": "Bearer ug_garbage"},
    "half of one": lambda service, client: {
        "Authorization": f"Bearer {service.token[:-1]}"
    },
    "expired": expired,
    "revoked": revoked,
    "ended session": ended_session,
    "session as a cookie": session_as_a_cookie,
    "token as a cookie": lambda service, client: {
        "Cookie": f"unghost_session={service.token}; session={service.token}",
        "Origin": service.url,
    },
}


@pytest.mark.parametrize("which", INVALID_CREDENTIALS)
def test_every_route_refuses_requests_without_a_valid_token(
    service, admin, path_values, which
):
    headers = INVALID_CREDENTIALS[which](service, admin)

    with service.client(**headers) as client:
        statuses = statuses_of(client, path_values)

    assert set(statuses.values()) == UNAUTHORISED


def test_expired_and_revoked_tokens_have_their_own_error_codes(service, admin):
    for which in ("expired", "revoked"):
        headers = INVALID_CREDENTIALS[which](service, admin)
        token = headers["Authorization"].split()[1]

        by_header = admin.get("/version", headers=headers).json()
        by_login = admin.post("/api/v1/session", json={"token": token}).json()

        assert by_header["code"] == by_login["code"] == f"token_{which}"


def test_session_expires_with_its_token(service, admin):
    token = new_token(admin)
    session = open_session(service, token["token"])
    expire(service, token)

    with service.client(**session) as browser:
        response = browser.get("/version")

    assert (response.status_code, response.json()["code"]) == (401, "token_expired")
