"""Many who write at the same time wait for each other, and all of them get done."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import httpx

CLIENTS = 100
THREADS_OF_THE_SERVICE = 40


def test_more_writers_than_threads_all_get_their_answer(service):
    """They hold the writer's place while their answer is made, which takes a thread."""
    assert CLIENTS > 2 * THREADS_OF_THE_SERVICE

    def post(number: int) -> int:
        body = {"name": f"writer {number}"}
        return client.post("/probe/tokens/early", json=body).status_code

    limits = httpx.Limits(max_connections=CLIENTS)
    with (
        httpx.Client(
            base_url=service.url, headers=service.bearer, limits=limits, timeout=25
        ) as client,
        ThreadPoolExecutor(CLIENTS) as pool,
    ):
        codes = list(pool.map(post, range(3 * CLIENTS)))

    assert codes == [201] * len(codes)


def test_probes_do_not_keep_writers_from_writing(service):
    def ask(number: int) -> int:
        if number % 10:
            return client.get("/readyz").status_code
        body = {"name": f"between probes {number}"}
        return client.post("/probe/tokens/early", json=body).status_code

    limits = httpx.Limits(max_connections=CLIENTS)
    with (
        httpx.Client(
            base_url=service.url, headers=service.bearer, limits=limits, timeout=25
        ) as client,
        ThreadPoolExecutor(CLIENTS) as pool,
    ):
        codes = list(pool.map(ask, range(3 * CLIENTS)))

    assert set(codes) == {200, 201}
