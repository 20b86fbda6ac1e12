"""Many concurrent writers wait for each other, and all of them are answered."""

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import httpx
import pytest

from app.main import create_app
from app.serve import server_config
from app.settings import Settings
from tests.support import plain_http

CLIENTS = 100
THREADS_OF_THE_SERVICE = 40
CREATED = 201


def statuses_of(service, ask):
    """What `ask` gives for a client and a number, asked by many people at once."""
    limits = httpx.Limits(max_connections=CLIENTS)
    place = {"base_url": service.url, "headers": service.bearer}
    with (
        plain_http.Client(**place, limits=limits) as client,
        ThreadPoolExecutor(CLIENTS) as people,
    ):
        return list(people.map(partial(ask, client), range(3 * CLIENTS)))


def write(client, number):
    body = {"name": f"writer {number}"}
    return client.post("/probe/tokens/early", json=body).status_code


def test_more_concurrent_writers_than_threads_are_all_answered(service):
    """A writer keeps others waiting until its answer is made, which needs a thread."""
    assert CLIENTS > 2 * THREADS_OF_THE_SERVICE

    assert set(statuses_of(service, write)) == {CREATED}


@pytest.mark.long
def test_readiness_probes_do_not_block_writers(serve):
    def ask(client, number):
        if number % 10:
            client.get("/readyz")  # on a busy machine it may not be ready
            return CREATED
        return write(client, number)

    assert set(statuses_of(serve(), ask)) == {CREATED}


def test_server_keep_alive_is_longer_than_that_of_clients(tmp_path):
    """Otherwise a client may send a request on a connection that is being closed."""
    app = create_app(Settings(data=tmp_path / "data"))

    expiry = httpx.Limits().keepalive_expiry or 0
    assert server_config(app).timeout_keep_alive > 2 * expiry
