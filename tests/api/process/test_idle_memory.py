"""A service that is idle again after a peak returns the memory that it has freed."""

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.support import plain_http
from tests.support.waiting import until

BODY = b'{"name": 1, "description": "' + b"x" * (15 * 1024**2) + b'"}'
CLIENTS = 8


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux for its memory")
def test_memory_of_a_peak_is_returned_when_the_service_is_idle(start_server):
    server = start_server()
    status = Path(f"/proc/{server.process.pid}/status")

    def resident_and_peak() -> tuple[int, int]:
        text = status.read_text("ascii")
        now, peak = (
            int(text.partition(f"{name}:")[2].split()[0]) for name in ("VmRSS", "VmHWM")
        )
        return now, peak

    def send(_: int) -> int:
        headers = {**server.headers, "Content-Type": "application/json"}
        url = f"{server.url}/api/v1/datasets"
        return plain_http.post(url, content=BODY, headers=headers).status_code

    before, _ = resident_and_peak()
    with ThreadPoolExecutor(CLIENTS) as clients:
        statuses = set(clients.map(send, range(3 * CLIENTS)))

    def is_returned() -> bool:
        now, peak = resident_and_peak()
        return now - before < 0.75 * (peak - before)

    until(is_returned, resident_and_peak)
    assert statuses == {422}
