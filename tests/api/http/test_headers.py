"""The security headers that every answer carries, and how many a request may have."""

from app.process.server import MOST_HEADERS
from tests.support.connections import open_connection, read_until_closed, request_head

ANSWERS = ["/healthz", "/no-such-page", "/probe/raise/internal", "/openapi.json"]


def test_every_response_has_the_security_headers(admin):
    refused = admin.get("/version", headers={"Host": "evil.example"})
    assert refused.headers["x-request-id"] == refused.json()["request_id"]

    for response in (refused, *map(admin.get, ANSWERS)):
        headers = response.headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "frame-ancestors 'none'" in policy
        assert "unsafe" not in policy
        assert "require-trusted-types-for 'script'; trusted-types 'none'" in policy
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert headers["cross-origin-opener-policy"] == "same-origin"
        assert "access-control-allow-origin" not in headers
        assert "server" not in headers


def test_cors_preflight_is_refused(admin):
    ask = {"Origin": "http://evil.example", "Access-Control-Request-Method": "PUT"}

    response = admin.options("/healthz", headers=ask)

    assert response.status_code == 405
    assert "access-control-allow-origin" not in response.headers


def test_headers_are_limited_in_number_before_the_head_has_ended(service):
    last = b"Connection: close\r\n"
    begun = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n"
    begun += b"a:\r\n" * (MOST_HEADERS - 2)
    with open_connection(service.url) as connection:
        connection.sendall(begun + last + b"\r\n")
        accepted = read_until_closed(connection)
    with open_connection(service.url) as connection:
        connection.sendall(begun + last * 3)
        refused = read_until_closed(connection)

    assert accepted.startswith(b"HTTP/1.1 200 ")
    assert refused.startswith(b"HTTP/1.1 431 ")
    assert f"has more than {MOST_HEADERS} headers".encode() in refused


def test_trailer_is_not_a_header(service):
    framing = {"Transfer-Encoding": "chunked", "Connection": "close"}
    trailer = f"Authorization: {service.bearer['Authorization']}\r\n\r\n".encode()
    head = request_head("GET", "/api/v1/datasets", framing)
    with open_connection(service.url) as connection:
        connection.sendall(head + b"1\r\nx\r\n0\r\n" + trailer)
        response = read_until_closed(connection)

    assert response.startswith(b"HTTP/1.1 401 ")
