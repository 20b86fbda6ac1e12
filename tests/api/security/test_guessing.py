"""Guessed tokens: every one is refused alike, and after some of them one waits."""

from __future__ import annotations

import httpx
import pytest

SESSION = "/api/v1/session"
MOST = 4


@pytest.fixture
def service(serve):
    return serve(max_failed_logins=MOST)


def by_login(client, token):
    return client.post(SESSION, json={"token": token})


def by_header(client, token):
    return client.get("/version", headers={"Authorization": f"Bearer {token}"})


def by_session(client, token):
    return by_header(client, token.replace("ug_", "us_"))


def by_code(client, token):
    return client.post(SESSION, json={"code": token.replace("ug_", "uc_")})


def by_address(client, token):
    key = token.replace("ug_", "ud_")
    return client.get("/api/v1/exports/1/file", params={"key": key})


WAYS = [by_login, by_header, by_session, by_code, by_address]


@pytest.mark.parametrize("way", WAYS)
def test_after_some_wrong_ones_one_is_told_how_long_to_wait(service, way):
    with service.client() as client:
        wrong = [way(client, f"ug_{number}") for number in range(MOST)]
        late = way(client, "ug_late")

    assert {answer.status_code for answer in wrong} == {401}
    assert (late.status_code, late.json()["code"]) == (429, "too_many_logins")
    assert 1 <= int(late.headers["retry-after"]) <= 60
    assert f"try again in {late.headers['retry-after']} s" in late.json()["detail"]


def test_ways_are_counted_together(service):
    with service.client() as client:
        for number in range(MOST):
            WAYS[(number + 1) % len(WAYS)](client, f"ug_{number}")

        assert {way(client, "ug_late").status_code for way in WAYS} == {429}


def test_the_right_one_is_not_let_in_either_by_who_has_guessed(service):
    """Else the answer would tell which guess was right, however late it comes."""
    with service.client() as client:
        for number in range(MOST):
            by_header(client, f"ug_{number}")

        assert by_header(client, service.token).status_code == 429
        assert by_login(client, service.token).status_code == 429


def test_who_works_already_is_not_shut_out(service):
    with service.admin() as working, service.client() as browser:
        opened = by_login(browser, service.token).json()
        session = {"Authorization": f"Bearer {opened['session']}"}
        assert working.get("/version").status_code == 200
        for number in range(MOST):
            by_header(browser, f"ug_{number}")
        service.app.state.services.callers._held.clear()  # as a second later

        assert by_header(browser, "ug_late").status_code == 429
        assert working.get("/version").status_code == 200
        assert browser.get("/version", headers=session).status_code == 200


def test_an_old_token_shown_again_and_again_shuts_nobody_out(service):
    with service.client() as client:
        old = {by_header(client, "ug_old").status_code for _ in range(3 * MOST)}

        assert old == {401}
        assert by_login(client, service.token).status_code == 201


def test_no_header_makes_it_another_address(service):
    with service.client() as client:
        statuses = [
            client.get(
                "/version",
                headers={
                    "Authorization": f"Bearer ug_{number}",
                    "X-Forwarded-For": f"192.0.2.{number}",
                },
            ).status_code
            for number in range(MOST + 1)
        ]

    assert statuses == [401] * MOST + [429]


def test_behind_a_trusted_proxy_the_address_is_that_of_the_client(serve):
    service = serve(max_failed_logins=1, trusted_proxies=("127.0.0.1",))

    def ask(client: httpx.Client, token: str, address: str) -> int:
        headers = {"Authorization": f"Bearer {token}", "X-Forwarded-For": address}
        return client.get("/version", headers=headers).status_code

    with service.client() as proxy:
        assert ask(proxy, "ug_a", "192.0.2.1") == 401
        assert ask(proxy, "ug_b", "192.0.2.1") == 429
        # What somebody wrote there before the proxy did is not believed.
        assert ask(proxy, "ug_c", "198.51.100.7, 192.0.2.1") == 429
        assert ask(proxy, "ug_b", "192.0.2.2") == 401


def test_who_shows_nothing_is_no_guesser(service):
    with service.client() as client:
        statuses = {client.get("/version").status_code for _ in range(3 * MOST)}

        assert statuses == {401}
        assert by_login(client, service.token).status_code == 201
