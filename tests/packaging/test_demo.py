"""`unghost demo` works from an installation, in a folder without the checkout."""

import pytest

from tests.support import plain_http
from tests.support.servers import (
    start_anew,
    stop,
    token_of,
    wait_for_link,
    wait_until_ready,
)
from tests.support.waiting import until


@pytest.mark.parametrize(
    "kind",
    ["installation", pytest.param("lowest_installation", marks=pytest.mark.long)],
)
def test_the_demo_renders_filters_and_serves(kind, request, tmp_path):
    installation = request.getfixturevalue(kind)
    options = ["demo", "--frames", "1", "--port", "0"]
    command = [str(installation.command("unghost")), *options]
    log = tmp_path / "log"

    process = start_anew(command, tmp_path / "data", log, {})
    try:
        url = wait_for_link(process, log).partition("/#")[0]
        headers = {"Authorization": f"Bearer {token_of(tmp_path / 'data')}"}
        with plain_http.Client(base_url=url, headers=headers, timeout=60) as client:
            wait_until_ready(url)
            page = client.get("/")
            # It is rendered after the start.
            demo = "/api/v1/datasets/demo/stats"
            until(lambda: client.get(demo).json().get("frames") == 1)
            stats = client.get(demo).json()
            quality = client.get("/api/v1/datasets/demo/quality")
            made = client.post("/api/v1/datasets", json={"name": "another"})
    finally:
        stop(process)

    assert page.status_code == 200
    assert quality.status_code == 200
    assert made.status_code == 201
    assert stats["frames"] == 1
    assert stats["kept"] > 0
    assert stats["rejected"] > 0
