"""Behind a proxy with TLS: the page works, and a forwarded host is not trusted."""

import pytest

HOST = "boxes.example"
PAGE = {"Host": HOST, "X-Forwarded-Proto": "https", "X-Forwarded-For": "192.0.2.1"}


@pytest.fixture
def service(serve):
    return serve(allowed_hosts=(HOST,), trusted_proxies=("127.0.0.1",))


def test_session_write_behind_a_tls_proxy_checks_the_https_origin(service):
    with service.client(**PAGE, Origin=f"https://{HOST}") as browser:
        opened = browser.post("/api/v1/session", json={"token": service.token})
        session = {"Authorization": f"Bearer {opened.json()['session']}"}

        written = browser.post("/probe/echo", headers=session)
        elsewhere = browser.post(
            "/probe/echo", headers={**session, "Origin": "https://evil.example"}
        )

    assert opened.status_code == 201
    assert "set-cookie" not in opened.headers
    assert (written.status_code, elsewhere.status_code) == (200, 403)


def test_forwarded_host_header_is_not_trusted(service):
    with service.client(Host="evil.example", **{"X-Forwarded-Host": HOST}) as client:
        assert client.get("/version").status_code == 421
