"""Wrong tokens are refused and counted in the log; right ones still work."""

import logging
import tracemalloc

import pytest

from app.access.gate import WrongSecrets, write_upkeep
from tests.support.databases import everything_in

SESSION = "/api/v1/session"
GUESSES = 50
"""More wrong tokens from one address than mistyping explains."""


@pytest.fixture
def service(serve):
    return serve()


def by_login(client, token):
    return client.post(SESSION, json={"token": token})


def by_header(client, token):
    return client.get("/version", headers={"Authorization": f"Bearer {token}"})


def by_session(client, token):
    return by_header(client, token.replace("ug_", "us_"))


def by_code(client, token):
    return client.post(SESSION, json={"code": token.replace("ug_", "uc_")})


def by_export_key(client, token):
    key = token.replace("ug_", "ud_")
    return client.get("/api/v1/exports/1/file", params={"key": key})


WAYS_TO_GUESS = [by_login, by_header, by_session, by_code, by_export_key]


def test_wrong_credentials_give_one_log_line_no_write_and_do_not_shut_out_valid_ones(
    service, caplog
):
    with service.client() as client, service.admin() as admin:
        code = admin.post("/api/v1/login-codes").json()["code"]
        write_upkeep(service.app.state.services)
        before = everything_in(service.settings.data)
        wrong = [
            WAYS_TO_GUESS[number % len(WAYS_TO_GUESS)](client, f"ug_{number}")
            for number in range(GUESSES)
        ]
        for _ in range(2):
            write_upkeep(service.app.state.services)
        after = everything_in(service.settings.data)

        by_link = client.post(SESSION, json={"code": code})
        by_token = by_login(client, service.token)
        shown = by_header(client, service.token)
        session = by_header(client, by_link.json()["session"])

    assert {response.status_code for response in wrong} == {401}
    warnings = [
        record.getMessage()
        for record in caplog.records
        # Warnings about a slow event loop, on a busy machine, are not about tokens.
        if record.levelno >= logging.WARNING and record.module != "loop_watch"
    ]
    assert warnings == [
        f"requests refused within a minute: {GUESSES} with a wrong token, session, "
        f"code or key: {GUESSES} from 127.0.0.1"
    ]
    assert after == before
    assert (by_link.status_code, by_token.status_code) == (201, 201)
    assert (shown.status_code, session.status_code) == (200, 200)


def test_a_request_without_a_token_is_not_counted_as_wrong(service, caplog):
    with service.client() as client:
        statuses = {client.get("/version").status_code for _ in range(GUESSES)}
        write_upkeep(service.app.state.services)

    assert statuses == {401}
    assert "wrong token" not in caplog.text


@pytest.mark.parametrize(
    ("proxies", "named"),
    [((), "3 from 127.0.0.1"), (("127.0.0.1",), "2 from 192.0.2.1, 1 from 192.0.2.2")],
)
def test_forwarded_address_is_used_from_a_trusted_proxy_only(
    serve, caplog, proxies, named
):
    service = serve(trusted_proxies=proxies)

    def ask(client, address):
        shown = {"Authorization": "Bearer ug_a", "X-Forwarded-For": address}
        assert client.get("/version", headers=shown).status_code == 401

    with service.client() as proxy:
        ask(proxy, "192.0.2.1")
        # Only the address that the proxy added counts: the one before it may be forged.
        ask(proxy, "198.51.100.7, 192.0.2.1")
        ask(proxy, "192.0.2.2")
    write_upkeep(service.app.state.services)

    assert any(said.endswith(f"code or key: {named}") for said in caplog.messages)


def test_counting_wrong_tokens_of_many_addresses_uses_little_memory():
    wrong = WrongSecrets()
    tracemalloc.start()
    for number in range(5000):
        wrong.note(f"10.0.{number >> 8}.{number & 255}")
        wrong.note("192.0.2.1" if number else "192.0.2.9")
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()

    assert held < 40 * 5000  # keeping all addresses would take twice as much
    assert wrong.take() == (
        "10000 with a wrong token, session, code or key: 4999 from 192.0.2.1, "
        "1 from 10.0.0.0, 1 from 192.0.2.9, 4999 from other addresses"
    )
    assert wrong.take() == ""
