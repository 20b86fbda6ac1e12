"""Tokens: created and revoked by admins, shown once, stored as hashes."""

from datetime import datetime, timezone

import pytest


def create(client, name, **more):
    return client.post("/api/v1/tokens", json={"name": name, **more})


def test_new_token_authenticates_as_its_name_and_is_shown_once(service, admin):
    response = create(admin, "Zoë 日本", role="reviewer")

    token = response.json()["token"]
    with service.client(Authorization=f"Bearer {token}") as client:
        assert client.post("/probe/echo").status_code == 200
        assert "'Zoë 日本' has reviewer" in client.post("/probe/admin-only").text
    assert response.status_code == 201
    assert response.headers["cache-control"] == "no-store"
    listed = admin.get("/api/v1/tokens")
    assert token not in listed.text
    (shown,) = (each for each in listed.json()["items"] if each["name"] == "Zoë 日本")
    assert shown["role"] == "reviewer"
    assert set(shown) == {
        *("id", "name", "role", "created_at", "expires_at", "revoked_at"),
        "last_used_at",
    }


@pytest.mark.sqlite_files("its files are searched")
def test_token_created_with_idempotency_key_is_not_stored_in_plain(service, admin):
    headers = {"Idempotency-Key": "give-bob-a-token"}
    body = {"name": "bob"}

    first = admin.post("/api/v1/tokens", json=body, headers=headers)
    again = admin.post("/api/v1/tokens", json=body, headers=headers)

    files = service.settings.data.glob("unghost.db*")
    assert (first.status_code, again.status_code) == (201, 409)
    assert not any(first.json()["token"].encode() in f.read_bytes() for f in files)


def test_revoked_token_and_its_sessions_are_unauthorised_at_once(service, admin):
    token = create(admin, "eve").json()
    with service.client() as browser:
        opened = browser.post("/api/v1/session", json={"token": token["token"]}).json()
        browser.headers["Authorization"] = f"Bearer {opened['session']}"
        before = browser.get("/version").status_code

        response = admin.delete(f"/api/v1/tokens/{token['id']}")

        assert (before, response.status_code) == (200, 204)
        assert browser.get("/version").status_code == 401
    with service.client(Authorization=f"Bearer {token['token']}") as client:
        assert client.get("/version").status_code == 401


def test_last_admin_token_and_missing_ones_cannot_be_revoked(serve):
    with serve().admin() as client:
        own = client.get("/api/v1/tokens").json()["items"][0]["id"]
        missing = client.delete("/api/v1/tokens/9999")
        alone = client.delete(f"/api/v1/tokens/{own}")
        create(client, "second", role="admin")
        followed = client.delete(f"/api/v1/tokens/{own}")

    statuses = [response.status_code for response in (missing, alone, followed)]
    assert statuses == [404, 409, 204]


@pytest.mark.parametrize(
    ("body", "status"),
    [
        ({"name": "admin"}, 409),
        ({"name": ""}, 422),
        ({"name": "a\nb"}, 422),
        ({"name": " "}, 422),
        ({"name": "x" * 101}, 422),
        ({"name": "kim", "role": "owner"}, 422),
        ({"name": "kim", "hash": "0" * 64}, 422),
        ({"name": "kim", "expires_at": "2001-01-01T00:00:00Z"}, 422),
        ({"name": "kim", "expires_at": "2100-01-01T00:00:00"}, 422),
    ],
)
def test_invalid_new_token_is_refused(admin, body, status):
    assert admin.post("/api/v1/tokens", json=body).status_code == status


def test_token_list_is_paginated(serve):
    with serve().admin() as client:
        for name in ("a", "b", "c"):
            create(client, name)
        first = client.get("/api/v1/tokens?limit=2")
        link = first.headers["link"].partition(">")[0].lstrip("<")
        second = client.get(link)

    names = [
        token["name"] for page in (first, second) for token in page.json()["items"]
    ]
    assert names == ["admin", "a", "b", "c"]
    assert second.json()["next_cursor"] is None


def test_session_returns_name_role_and_expiry_of_its_token(service, admin):
    lasting = create(admin, "grace", role="reviewer", expires_in_days=7).json()["token"]

    with service.client(Authorization=f"Bearer {lasting}") as client:
        session = client.get("/api/v1/session").json()

    assert (session["name"], session["role"]) == ("grace", "reviewer")
    assert session["expires_at"] > datetime.now(timezone.utc).isoformat()
    assert admin.get("/api/v1/session").json()["role"] == "admin"
