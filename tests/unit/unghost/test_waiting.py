"""What waiting for a server's work says when the server goes away."""

from __future__ import annotations

import httpx
import pytest

from tests.unit.unghost.conftest import QUICK
from unghost import Client, Run
from unghost.cli.screen import Screen
from unghost.cli.waiting import wait_for_run

RUN = {"id": 21, "dataset": "town", "state": "running", "total": 9, "done": 3}


def test_a_run_whose_server_is_away_goes_on_and_can_be_followed(closed_port, capsys):
    address = f"http://127.0.0.1:{closed_port}"

    with (
        Client(address, "secret", retry=QUICK) as client,
        pytest.raises(httpx.ConnectError),
    ):
        wait_for_run(client, Run.read(RUN), Screen())

    said = capsys.readouterr().err
    assert "run 21 goes on with the server: `unghost wait 21` follows it" in said
