"""Many concurrent writers wait for each other, and all of them are answered."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest

from app.main import create_app
from app.serve import server_config
from app.settings import Settings
from tests.support import plain_http

CLIENTS = 100
THREADS_OF_THE_SERVICE = 40
CREATED = 201


def test_more_concurrent_writers_than_threads_are_all_answered(service):
    """A writer keeps others waiting until its answer is made, which needs a thread."""
    assert CLIENTS > 2 * THREADS_OF_THE_SERVICE

    def post(number: int) -> int:
        body = {"name": f"writer {number}"}
        return client.post("/probe/tokens/early", json=body).status_code

    limits = httpx.Limits(max_connections=CLIENTS)
    with (
        plain_http.Client(
            base_url=service.url, headers=service.bearer, limits=limits
        ) as client,
        ThreadPoolExecutor(CLIENTS) as pool,
    ):
        codes = list(pool.map(post, range(3 * CLIENTS)))

    assert codes == [201] * len(codes)


@pytest.mark.long
def test_readiness_probes_do_not_block_writers(service):
    def ask(number: int) -> int:
        if number % 10:
            client.get("/readyz")  # on a busy machine it may not be ready
            return CREATED
        body = {"name": f"between probes {number}"}
        return client.post("/probe/tokens/early", json=body).status_code

    limits = httpx.Limits(max_connections=CLIENTS)
    with (
        plain_http.Client(
            base_url=service.url, headers=service.bearer, limits=limits
        ) as client,
        ThreadPoolExecutor(CLIENTS) as pool,
    ):
        codes = list(pool.map(ask, range(3 * CLIENTS)))

    assert set(codes) == {CREATED}


def test_server_keep_alive_is_longer_than_that_of_clients(tmp_path):
    """Otherwise a client may send a request on a connection that is being closed."""
    app = create_app(Settings(data=tmp_path / "data"))

    expiry = httpx.Limits().keepalive_expiry or 0
    assert server_config(app).timeout_keep_alive > 2 * expiry
