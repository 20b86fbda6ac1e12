"""The log of requests: each is identified, and no secret is logged."""

import json
import re

import pytest

from app.logs import MAX_PATH, JsonLines
from tests.support import archives, plain_http
from tests.support import frames as scene
from tests.support.api import BASE
from tests.support.connections import open_connection
from tests.support.servers import stop
from tests.support.waiting import until

pytestmark = pytest.mark.long

SECRET = "hunter2"
TOKEN = f"ug_{SECRET}{'x' * 36}"


def log_with(server, text, times=1):
    """Wait until the log has this text; return the log.

    A request is logged only after its answer was sent.
    """
    until(lambda: log_of(server).count(text) >= times, lambda: log_of(server))
    return log_of(server)


def log_of(server):
    return server.log.read_text("utf-8")


def log_lines_for(server, path):
    """The lines of the log about the requests for a path."""
    lines = log_with(server, f'"path":"{path}"').splitlines()
    return [line for line in map(json.loads, lines) if line.get("path") == path]


def test_request_log_line_has_id_route_status_duration_and_caller(start_api):
    """A long path is cut: otherwise anybody could fill the disk, without a token."""
    server, api = start_api()

    response = api.http.get(
        f"{BASE}/datasets/none", headers={"X-Request-ID": "night-shift.7"}
    )
    api.http.get("/" + "%01" * 20_000)

    assert response.headers["X-Request-ID"] == "night-shift.7"
    (line,) = log_lines_for(server, f"{BASE}/datasets/none")
    assert line.pop("time").endswith("Z")
    assert line.pop("duration_ms") >= 0
    assert line.pop("message").startswith(f"GET {BASE}/datasets/none 404 ")
    assert line == {
        "level": "info",
        "logger": "unghost.access",
        "request_id": "night-shift.7",
        "method": "GET",
        "path": f"{BASE}/datasets/none",
        "status": 404,
        "route": f"{BASE}/datasets/{{dataset}}",
        "caller": "admin",
        "client": "127.0.0.1",
    }
    log = log_with(server, "(20001 characters)")
    (cut,) = [line for line in log.splitlines() if "(20001 characters)" in line]
    assert len(cut) < 20 * MAX_PATH


@pytest.mark.parametrize(
    "harmful",
    ["", "ä", "a b", "x" * 65, "-a", "a\x1b[2J", 'a","level":"none'],
    ids=repr,
)
def test_invalid_request_id_is_replaced(admin, harmful):
    response = admin.get(
        "/healthz", headers={"X-Request-ID": harmful.encode("latin-1")}
    )

    assert response.headers["X-Request-ID"].isalnum()
    assert len(response.headers["X-Request-ID"]) == 32


def test_log_format_text_writes_plain_text(start_server):
    server = start_server(UNGHOST_LOG_FORMAT="text")

    plain_http.get(f"{server.url}/version", headers=server.headers)

    log = log_with(server, "GET /version 200 ")
    assert " INFO unghost.access [" in log


def test_log_level_warning_logs_no_requests(start_server):
    server = start_server(UNGHOST_LOG_LEVEL="warning")

    plain_http.get(f"{server.url}/version", headers=server.headers)

    stop(server.process)
    assert server.log.read_text("utf-8") == ""


def test_no_secret_of_any_request_is_logged(start_api):
    server, api = start_api(UNGHOST_LOG_LEVEL="debug")
    name = api.dataset(description=SECRET)
    box = api.upload_frame(name, "a")["decisions"][0]["box_id"]
    made = api.post("/tokens", {"name": "ada", "role": "reviewer"}).json()["token"]

    statuses = [
        *call_all_routes(api),
        *send_valid_writes(api, name, box),
        *send_invalid_requests(server, api, name),
        *send_credentials(server, made),
    ]
    send_malformed_request(server)

    log = log_with(server, '"logger":"unghost.access"', len(statuses))
    assert {200, 201, 204, 401, 404, 415, 422} <= set(statuses)
    assert SECRET not in log
    assert made not in log
    assert server.token not in log


def call_all_routes(api):
    """Call every route with the secret in the body, the query and headers; statuses."""
    document = api.http.get("/openapi.json").json()
    headers = {"User-Agent": SECRET, "If-Match": f'"{SECRET}"', "X-Any": SECRET}
    statuses = []
    for path, methods in document["paths"].items():
        url = re.sub(r"\{\w+\}", "1", path)
        for method in sorted({"get", "put", "post", "patch", "delete"} & {*methods}):
            response = api.http.request(
                method, url, json={"any": SECRET}, params={"q": SECRET}, headers=headers
            )
            statuses.append(response.status_code)
    assert len(statuses) > 50
    assert max(statuses) < 500
    return statuses


def send_valid_writes(api, name, box):
    """Valid writes whose bodies hold the secret; their statuses."""
    headers = {"Idempotency-Key": SECRET}
    bulk = {"dataset": name, "box_ids": [box], "seen_revisions": [1]}
    bulk |= {"verdict": "keep", "comment": SECRET}
    body = {"verdict": "reject", "comment": SECRET, "seen_revision": 0}
    url = f"{BASE}/boxes/{box}/reviews"
    said = [api.http.post(url, json=body, headers=headers) for _ in range(2)]
    responses = [
        *said,
        api.post("/reviews/bulk", bulk),
        api.put(name, "c", {**scene.annotation(), "map": SECRET}),
        archives.send(api, name, archives.tar_archive(archives.frame("b", map=SECRET))),
        api.get(f"/datasets/{name}"),
    ]
    return [response.status_code for response in responses]


def send_invalid_requests(server, api, name):
    """Invalid requests with the secret in the part that is wrong; their statuses."""
    text = {"Content-Type": f"text/{SECRET}"}
    form = {"Content-Type": f"multipart/form-data; boundary={SECRET}"}
    frame = f"{BASE}/datasets/{name}/frames/d"
    responses = [
        api.http.get("/version", params={"token": SECRET}),
        api.http.get(f"/login/{TOKEN}"),
        api.post("/datasets", {"name": [SECRET], SECRET: SECRET}),
        api.post(f"/datasets/{name}/runs", {"config": {SECRET: SECRET}}),
        api.put(name, "d", f'{{"boxes": "{SECRET}"'.encode()),
        api.put(name, "d", {**scene.annotation(), "boxes": [{"id": SECRET}]}),
        api.put(name, "d", image=SECRET.encode(), segmentation=SECRET.encode()),
        api.http.put(frame, content=SECRET.encode(), headers=form),
        archives.send(api, name, SECRET.encode() * 99, text),
        archives.send(api, name, SECRET.encode() * 999),
    ]
    return [response.status_code for response in responses]


def send_credentials(server, made):
    """Requests with valid and invalid tokens, sessions and codes; their statuses."""
    with plain_http.Client(base_url=server.url) as client:
        responses = [
            client.get("/version", headers={"Authorization": f"Bearer {TOKEN}"}),
            client.get("/version", headers={"Authorization": f"Basic {SECRET}"}),
            client.get("/version", headers={"Cookie": f"unghost_session={SECRET}"}),
            client.post(f"{BASE}/session", json={"token": TOKEN}),
            client.get("/version"),
            client.get("/version", headers={"Referer": f"/#token={made}"}),
        ]
        opened = client.post(f"{BASE}/session", json={"token": made}).json()
        session = {"Authorization": f"Bearer {opened['session']}"}
        bearer = {"Authorization": f"Bearer {made}"}
        code = client.post(f"{BASE}/login-codes", headers=bearer).json()["code"]
        responses += [
            client.get(f"/{code}", headers=session),
            client.get(f"{BASE}/exports/1/file", params={"key": f"ud_{SECRET}"}),
            client.post(f"{BASE}/session", json={"code": code}),
            client.delete(f"{BASE}/session", headers=session),
        ]
    log = server.log.read_text("utf-8")
    assert opened["session"] not in log
    assert code not in log
    return [response.status_code for response in responses]


def send_malformed_request(server):
    with open_connection(server.url) as connection:
        connection.sendall(f"GET /{SECRET}\r\nnot http at all\r\n\r\n".encode())
        with connection.makefile("rb") as stream:
            response = stream.read().decode()
    (request_id,) = re.findall(r"^x-request-id: (\w+)\r$", response, re.MULTILINE)
    assert response.startswith("HTTP/1.1 400 ")
    log_with(server, f'"request_id":"{request_id}"')


def test_logged_database_error_does_not_contain_the_written_values(service, caplog):
    with service.admin() as client:
        responses = [
            client.post("/probe/tokens/early", json={"name": SECRET}) for _ in range(2)
        ]

    lines = [JsonLines().format(record) for record in caplog.records]
    assert [response.status_code for response in responses] == [201, 409]
    assert any("INSERT INTO tokens" in line for line in lines)
    assert [line for line in lines if SECRET in line] == []
