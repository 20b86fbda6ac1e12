"""Every error is a problem document, whichever part of the service made it."""

import json

import pytest
from starlette.requests import ClientDisconnect

from app.http.problems import refusal_of
from tests.support.connections import open_connection, read_until_closed

INSIDES = ("locked", "select", "hunter2", "traceback")
"""Words of the errors behind server errors, which no response may have."""
KEYS = {
    *("type", "title", "status", "detail", "instance", "code", "request_id", "errors")
}


@pytest.mark.parametrize(
    ("method", "path", "status", "code"),
    [
        ("GET", "/probe/raise/bad-request", 400, "bad_request"),
        ("GET", "/probe/items/1?nonsense=1", 400, "unknown_parameter"),
        ("GET", "/no-such-page", 404, "not_found"),
        ("GET", "/api/v1/no-such-resource", 404, "not_found"),
        ("GET", "/healthz/", 404, "not_found"),
        *(("GET", f"/{name}", 404, "not_found") for name in ("blobs", "data", "token")),
        ("GET", "/unghost.db", 404, "not_found"),
        ("GET", "/static/no-such-file.js", 404, "not_found"),
        ("GET", "/probe/raise/missing", 404, "not_found"),
        ("PATCH", "/healthz", 405, "method_not_allowed"),
        ("GET", "/probe/raise/conflict", 409, "frame_conflict"),
        ("GET", "/probe/raise/stale", 412, "stale_review"),
        ("GET", "/probe/raise/range", 416, "range_not_satisfiable"),
        ("GET", "/probe/items/none", 422, "invalid_request"),
        ("GET", "/probe/items/99999999999999999999", 422, "invalid_request"),
        ("GET", "/probe/raise/filter", 422, "bad_annotation"),
        ("GET", "/probe/raise/quota", 429, "too_many_requests"),
        ("GET", "/probe/raise/internal", 500, "internal"),
        ("GET", "/probe/raise/busy", 503, "database_busy"),
        ("GET", "/probe/raise/full", 503, "storage_full"),
        ("GET", "/probe/raise/many-files", 503, "not_ready"),
        ("GET", "/probe/raise/away", 503, "not_ready"),
    ],
)
def test_an_error_is_a_problem_document(admin, method, path, status, code):
    response = admin.request(method, path)

    problem = response.json()
    assert response.headers["content-type"] == "application/problem+json"
    assert (response.status_code, problem["status"]) == (status, status)
    assert problem.keys() - {"current"} == KEYS
    assert problem["code"] == code
    assert problem["instance"] == path.partition("?")[0]
    assert problem["request_id"] == response.headers["x-request-id"]
    if status in (429, 503):
        assert int(response.headers["retry-after"]) > 0
    text = response.text.lower()
    assert [word for word in INSIDES if word in text] == [] or status < 500


@pytest.mark.parametrize(
    ("body", "media_type", "status", "code"),
    [
        ("", "application/json", 422, "invalid_request"),
        ('{"name": ', "application/json", 422, "invalid_request"),
        ('{"name": 1}', "application/json", 422, "invalid_request"),
        ("[" * 5000, "application/json", 422, "invalid_request"),
        (b'{"name": "\xff"}', "application/json", 422, "invalid_request"),
        ("name: x", "application/yaml", 415, "unsupported_media_type"),
        ('{"name": "x"}', "text/plain", 415, "unsupported_media_type"),
    ],
)
def test_unreadable_body_is_a_problem_document(admin, body, media_type, status, code):
    response = admin.post(
        "/probe/tokens", content=body, headers={"Content-Type": media_type}
    )

    assert response.headers["content-type"] == "application/problem+json"
    assert (response.status_code, response.json()["code"]) == (status, code)


def test_all_faults_have_pointers_to_the_body_the_path_or_the_query(admin):
    body = admin.post("/probe/tokens", json={"count": "many"}).json()
    parameters = admin.get("/probe/items/0?limit=all").json()
    annotation = admin.get("/probe/raise/filter").json()

    faults = {fault["pointer"]: fault["code"] for fault in body["errors"]}
    assert faults == {"/name": "missing", "/count": "int_parsing"}
    pointers = [fault["pointer"] for fault in parameters["errors"]]
    assert pointers == ["/path/item_id", "/query/limit"]
    pointers = [fault["pointer"] for fault in annotation["errors"]]
    assert pointers == ["/boxes/0/xyxy", "/boxes/2"]


def test_method_not_allowed_lists_the_allowed_methods(admin):
    response = admin.put("/api/v1/session")

    assert response.status_code == 405
    assert response.headers["allow"] == "GET, HEAD, POST, DELETE"


def test_an_unexpected_error_is_logged_and_a_client_disconnect_is_not(caplog):
    left = refusal_of(ClientDisconnect())
    assert (left.status, left.code) == (400, "client_disconnected")
    assert caplog.records == []

    refusal = refusal_of(RuntimeError("the disk is on fire"))

    assert (refusal.status, refusal.code) == (500, "internal")
    assert "fire" not in refusal.detail
    assert "the disk is on fire" in caplog.text


@pytest.mark.parametrize(
    "sent",
    [
        b"hello\r\n\r\n",
        b"\x16\x03\x01\x02\r\n\r\n",
        b"BREW / HTTP/1.1\r\nHost: a\r\n\r\n",
        b"GET / HTTP/1.1\r\nConnection: close\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: a\r\nHost: a\r\nConnection: close\r\n\r\n",
    ],
)
def test_malformed_http_request_is_a_problem_document(service, sent):
    with open_connection(service.url) as connection:
        connection.sendall(sent)
        received = read_until_closed(connection)

    head, _, body = received.partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 400 ")
    assert b"application/problem+json" in head
    assert json.loads(body).keys() == KEYS
