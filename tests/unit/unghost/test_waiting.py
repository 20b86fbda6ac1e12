"""What waiting for a server's work says when the server goes away."""

from __future__ import annotations

import httpx
import pytest

from tests.unit.unghost.conftest import QUICK, Reply, json_reply
from unghost import Client, Run
from unghost.cli.screen import Screen
from unghost.cli.waiting import wait_for_run
from unghost.retry import PATIENCE

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


def test_who_waits_outlasts_a_server_that_is_started_anew(scripted, client):
    silence = [Reply(hang_up=0)] * (PATIENCE * QUICK.attempts - 1)
    done = {**RUN, "state": "done", "done": 9}
    scripted.answer(json_reply(RUN), *silence, json_reply(done))

    run = client.wait(21, timeout_s=60)

    assert (run.state, scripted.replies) == ("done", [])


def test_who_waits_for_an_export_outlasts_it_too(scripted, client):
    export = {"id": 4, "dataset": "town", "state": "done", "total": 9, "done": 9}
    silence = [Reply(hang_up=0)] * (PATIENCE * QUICK.attempts - 1)
    scripted.answer(*silence, json_reply(export))

    assert client.wait_for_export(4, timeout_s=60).state == "done"
