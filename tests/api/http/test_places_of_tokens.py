"""No token takes the threads, or the turns to write, of all others."""

import json
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager

import pytest

from app.http.admission import MAX_READS_PER_TOKEN, MAX_WRITES_PER_TOKEN, Admission
from tests.support import probe_routes
from tests.support.connections import open_connection, request_head
from tests.support.waiting import until

pytestmark = pytest.mark.long

PATIENCE_S = 120
WAYS = {
    "GET": ("GET", "/probe/wait", MAX_READS_PER_TOKEN),
    "POST that stores nothing": ("POST", "/probe/wait", MAX_READS_PER_TOKEN),
    "POST that writes": ("POST", "/probe/wait/to-write", MAX_WRITES_PER_TOKEN),
}


def new_reviewer(service, admin):
    made = admin.post("/api/v1/tokens", json={"name": "greedy"}).json()
    return service.client(Authorization=f"Bearer {made['token']}")


@contextmanager
def blocked(service, admin, way, count):
    """One token sends requests that block; gives its client and their responses."""
    method, path, most = WAYS[way]
    probe_routes.unblock.clear()
    with new_reviewer(service, admin) as greedy, ThreadPoolExecutor(count) as threads:
        requests = [threads.submit(greedy.request, method, path) for _ in range(count)]
        try:
            for _ in range(most):
                assert probe_routes.waiting.acquire(timeout=PATIENCE_S)
            yield greedy, requests
        finally:
            probe_routes.unblock.set()


@pytest.mark.parametrize("way", WAYS)
def test_requests_of_one_token_do_not_block_others(serve, way):
    service = serve()
    with service.admin() as admin:
        with blocked(service, admin, way, 60) as (_, requests):
            reading = admin.get("/api/v1/datasets")
            writing = admin.post("/api/v1/datasets", json={"name": "street"})
        statuses = {request.result().status_code for request in requests}

    assert (reading.status_code, writing.status_code) == (200, 201)
    assert statuses == {200}


def test_write_whose_client_left_while_it_waited_is_not_executed(serve):
    service = serve()
    with service.admin() as admin, ExitStack() as opened:
        busy = blocked(service, admin, "POST that writes", MAX_WRITES_PER_TOKEN)
        greedy, _ = opened.enter_context(busy)
        token = admin.get("/api/v1/tokens").json()["items"][-1]["id"]
        places = service.app.state.services.one(Admission).writing.of(token)
        with ExitStack() as connections:
            for number in range(20):
                body = json.dumps({"name": f"left-{number}"}).encode()
                headers = {
                    "Authorization": greedy.headers["authorization"],
                    "Content-Type": "application/json",
                    "Content-Length": len(body),
                }
                connection = connections.enter_context(open_connection(service.url))
                connection.sendall(
                    request_head("POST", "/probe/tokens", headers) + body
                )
            until(lambda: places.statistics().tasks_waiting == 20)
        admin.get("/healthz")  # by now the service knows that they have left
        probe_routes.unblock.set()
        last = greedy.post("/probe/tokens", json={"name": "last"})
        names = [token["name"] for token in admin.get("/api/v1/tokens").json()["items"]]

    assert last.status_code == 201
    assert names == ["admin", "greedy", "last"]
