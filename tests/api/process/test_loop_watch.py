"""A blocked event loop is logged and counted; busy threads are not taken for one."""

import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families

from app.process.loop_watch import LONGEST_S
from tests.support import plain_http, probe_routes
from tests.support.waiting import until

PATIENCE_S = 60
SECONDS = "unghost_loop_stall_seconds_total"
THREADS = 40
"""How many threads the service has for requests."""


@pytest.fixture
def service_with_blocked_probes(serve):
    """A service whose probe routes wait for `unblock`, which is set in the end."""
    for event in (probe_routes.is_held, probe_routes.unblock):
        event.clear()
    while probe_routes.waiting.acquire(blocking=False):
        pass
    try:
        yield serve()
    finally:
        probe_routes.unblock.set()


def counted(client):
    return {
        sample.name: sample.value
        for family in text_string_to_metric_families(client.get("/metrics").text)
        for sample in family.samples
        if sample.name.startswith("unghost_loop_stall")
    }


def calls_in(log):
    """All calls in the stacks that were logged."""
    facts = [getattr(record, "facts", {}) for record in log.records]
    return [call for record in facts for call in record.get("stack", ())]


def test_blocked_event_loop_is_logged_with_its_stack_and_not_ready(
    service_with_blocked_probes, caplog
):
    with (
        service_with_blocked_probes.admin() as client,
        ThreadPoolExecutor(2) as threads,
    ):
        until(lambda: client.get("/readyz").status_code == 200)
        before = counted(client)
        holding = threads.submit(client.get, "/probe/hold")
        assert probe_routes.is_held.wait(PATIENCE_S)
        until(lambda: any(call.endswith(" hold") for call in calls_in(caplog)))
        request = threads.submit(client.get, "/readyz")
        probe_routes.unblock.set()
        response = request.result(PATIENCE_S)
        assert holding.result(PATIENCE_S).status_code == 200

        assert response.status_code == 503
        (fault,) = response.json()["errors"]
        assert fault["code"] == "event_loop"
        assert "for" in fault["detail"]
        assert client.get("/healthz").status_code == 200
        # Counted by another thread, maybe after these answers.
        until(lambda: counted(client)[SECONDS] - before[SECONDS] >= LONGEST_S)
        stalls = counted(client)["unghost_loop_stalls_total"]

        def readiness():
            response = client.get("/readyz")
            return response if response.status_code == 200 else None

        ready = until(readiness)

    assert ready.json()["checks"]["event_loop"] == "responsive"
    assert stalls > before["unghost_loop_stalls_total"]


def test_a_service_is_ready_while_all_threads_of_requests_are_busy(
    service_with_blocked_probes,
):
    with (
        service_with_blocked_probes.admin() as client,
        ThreadPoolExecutor(THREADS + 5) as threads,
    ):
        for _ in range(THREADS + 5):
            threads.submit(client.get, "/open/wait")
        for _ in range(THREADS):
            assert probe_routes.waiting.acquire(timeout=PATIENCE_S)

        alive = client.get("/healthz").status_code
        # On a busy machine the loop may have been late on its own a moment ago.
        until(lambda: client.get("/readyz").status_code == 200)
        probe_routes.unblock.set()

    assert alive == 200


STUCK = """
import asyncio, app.process.server as graceful, uvicorn

graceful.LAST_S = 0.5

async def stuck(scope, receive, send):
    print("stuck", flush=True)
    while True:
        pass

graceful.GracefulServer(
    uvicorn.Config(stuck, port=0, lifespan="off"),
    ready=lambda: None, stopping=lambda: None, wait_s=0,
).run(sockets=[SOCKET])
"""


def test_process_with_a_blocked_event_loop_exits_on_sigterm():
    listening = "__import__('socket').create_server(('127.0.0.1', 0))"
    script = f"LISTENER = {listening}\nprint(LISTENER.getsockname()[1], flush=True)\n"
    process = subprocess.Popen(
        [sys.executable, "-c", script + STUCK.replace("SOCKET", "LISTENER")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        port = int(process.stdout.readline())
        asking = threading.Thread(target=_ask, args=(port,))
        asking.start()
        assert process.stdout.readline() == "stuck\n"

        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=PATIENCE_S)
        asking.join()
    finally:
        process.kill()
        process.wait()

    assert process.returncode == 1
    assert "in stuck" in errors


def _ask(port):
    with pytest.raises(httpx.TransportError):
        plain_http.get(f"http://127.0.0.1:{port}", timeout=PATIENCE_S)
