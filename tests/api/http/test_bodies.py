"""Every route limits the size of its body, with or without a Content-Length."""

from contextlib import suppress
from itertools import product

import pytest
from fastapi.routing import APIRoute

from app.http.middleware import MAX_UNASKED_BYTES
from app.http.routing import ApiRoute, OpenRoute
from app.settings import Settings
from tests.support.archives import header_of
from tests.support.connections import (
    open_connection,
    read_response,
    read_until_closed,
    request_head,
)
from tests.support.live import live
from tests.support.routes import every_route, fill_path, operations, values_of_paths

LIMITS = {
    "max_json_bytes": 5_000,
    "max_config_bytes": 6_000,
    "max_body_bytes": 20_000,
    "max_part_bytes": 20_000,
    "max_batch_bytes": 30_000,
    "max_folder_bytes": 25_000,
}
FORM = (
    b'--b\r\nContent-Disposition: form-data; name="image"\r\n\r\n',
    "multipart/form-data; boundary=b",
)
STARTS = {
    "max_json_bytes": (b"[", "application/json"),
    "max_config_bytes": (b"# ", "application/yaml"),
    "max_body_bytes": FORM,
    "max_batch_bytes": (header_of("a.json", 10**6), "application/x-tar"),
    "max_folder_bytes": (header_of("a.txt", 10**6), "application/x-tar"),
}
VALUES = values_of_paths(999)
OPERATIONS = sorted(
    (method, route.path, route)
    for route in every_route()
    for method, _ in operations(route)
)


def setting_of(route: APIRoute) -> str:
    """The name of the setting that limits a route's body; empty if it takes none."""
    return (route.body_setting or "") if isinstance(route, OpenRoute) else ""


def limit_of(route: APIRoute) -> int:
    name = setting_of(route)
    is_open = not isinstance(route, ApiRoute)
    return MAX_UNASKED_BYTES if is_open or not name else LIMITS[name]


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    with live(tmp_path_factory.mktemp("bodies") / "data", **LIMITS) as running:
        with running.admin() as client:
            assert client.post("/api/v1/datasets", json={"name": "street"}).is_success
        yield running


def head(service, method, path, headers):
    return request_head(method, fill_path(path, VALUES), service.bearer | headers)


def send_to_every_route(service, framing, content=lambda route: b""):
    """Send this to every route, with and without an idempotency key.

    Gives the method, path and route, and the status, the headers and the body of the
    response. The server answers others before it has all of the body.
    """
    with service.client() as client:
        for (method, path, route), is_keyed in product(OPERATIONS, (False, True)):
            headers = dict(framing(route))
            media_type = STARTS.get(setting_of(route), (b"", "application/json"))[1]
            headers["Content-Type"] = media_type
            if is_keyed:
                headers["Idempotency-Key"] = f"{method}-{abs(hash(path))}"
            with open_connection(service.url) as connection:
                connection.sendall(head(service, method, path, headers))
                connection.sendall(content(route))
                assert client.get("/healthz").status_code == 200, (method, path)
                yield (method, path, route), read_response(connection)


def test_too_large_content_length_is_refused_before_the_body_is_read(service):
    def framing(route):
        return {"Content-Length": limit_of(route) + 1}

    for (_, path, route), response in send_to_every_route(service, framing):
        if path == "/":  # the page ignores the body of a request
            assert response[0] == 200
        else:
            assert_too_large(response, route)


def test_chunked_body_is_read_only_up_to_its_limit(service):
    """The body is never ended: a server that read past the limit would never answer."""

    def chunk_over_the_limit(route):
        start, _ = STARTS.get(setting_of(route), (b"[", ""))
        body = start.ljust(limit_of(route) + 1)
        return b"%x\r\n%b\r\n" % (len(body), body)

    chunked = {"Transfer-Encoding": "chunked"}
    sent = send_to_every_route(service, lambda _: chunked, chunk_over_the_limit)
    for (_, _, route), response in sent:
        if setting_of(route) not in ("", "max_batch_bytes"):
            assert_too_large(response, route)
            assert response[1]["connection"] == "close"


def assert_too_large(response, route):
    status, _, body = response
    assert (status, b'"too_large"' in body) == (413, True), (route.path, response)
    assert str(limit_of(route)).encode() in body


def pieces(total):
    for _ in range(total // 1000):
        yield b"x" * 1000


def test_body_at_the_limit_is_read(admin):
    limit = LIMITS["max_body_bytes"]

    assert admin.post("/probe/echo", content=b"x" * limit).json() == limit


def test_streamed_body_is_read_up_to_its_limit(admin):
    limit = LIMITS["max_batch_bytes"]

    taken = admin.post("/probe/stream", content=pieces(limit))
    refused = admin.post("/probe/stream", content=pieces(limit + 1000))

    assert (taken.json(), refused.status_code) == (limit, 413)


@pytest.mark.parametrize("extension", [b"", b";a=" + b"x" * 100])
def test_extensions_of_chunks_are_limited_and_small_chunks_are_not(service, extension):
    framing = {"Transfer-Encoding": "chunked", "Connection": "close"}
    size, received = LIMITS["max_body_bytes"], b""
    with open_connection(service.url) as connection, suppress(ConnectionError):
        connection.sendall(head(service, "POST", "/probe/echo", framing))
        connection.sendall(b"1%b\r\nx\r\n" % extension * size + b"0\r\n\r\n")
        received = read_until_closed(connection)

    assert received.endswith(str(size).encode()) == (extension == b"")


def test_too_large_body_without_a_token_returns_401_not_413(anonymous):
    too_large = pieces(LIMITS["max_batch_bytes"] * 2)

    assert anonymous.post("/probe/stream", content=too_large).status_code == 401


def test_every_body_limit_is_a_setting():
    named = {setting_of(route) for route in every_route()} - {""}

    assert named == set(LIMITS) - {"max_part_bytes"}
    assert named <= set(Settings.model_fields)


def test_every_route_with_a_body_names_its_size_setting(document):
    """Of a new route that names no setting, only 4 KiB of the body would be read."""
    described = {
        (method.upper(), path)
        for path, item in document["paths"].items()
        for method, operation in item.items()
        if "requestBody" in operation
    }

    named = {
        (m, path.replace(":any", "")) for m, path, r in OPERATIONS if setting_of(r)
    }
    assert named == described
