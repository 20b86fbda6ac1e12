"""The security headers that every answer carries, also a refusal."""

from __future__ import annotations

import pytest

ANSWERS = ["/healthz", "/no-such-page", "/probe/raise/internal", "/openapi.json"]


@pytest.mark.parametrize("path", ANSWERS)
def test_every_response_has_the_security_headers(admin, path):
    headers = admin.get(path).headers

    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "unsafe" not in policy
    assert "require-trusted-types-for 'script'; trusted-types api-docs" in policy
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["referrer-policy"] == "no-referrer"
    assert headers["cross-origin-opener-policy"] == "same-origin"
    assert "access-control-allow-origin" not in headers
    assert "server" not in headers


def test_response_to_a_refused_host_has_the_security_headers(admin):
    answer = admin.get("/healthz", headers={"Host": "evil.example"})

    assert answer.headers["x-content-type-options"] == "nosniff"
    assert answer.headers["x-request-id"] == answer.json()["request_id"]


def test_cors_preflight_is_refused(admin):
    ask = {"Origin": "http://evil.example", "Access-Control-Request-Method": "PUT"}

    answer = admin.options("/healthz", headers=ask)

    assert answer.status_code == 405
    assert "access-control-allow-origin" not in answer.headers
