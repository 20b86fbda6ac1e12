"""Waiting for runs and exports: restarts of the server, lost servers, Ctrl-C."""

import gzip
import json
from contextlib import contextmanager

import pytest

from tests.support.response_checks import EXPORT, RUN
from tests.support.scripted_server import SHORT_RETRIES, Reply, json_reply, problem
from unghost import Client, Export, NoResponse, Run, UnexpectedAnswer
from unghost.cli.export import wait_for_export
from unghost.cli.remote.runs import wait_for_run
from unghost.cli.screen import Screen
from unghost.client.jobs import MAX_EVENT_BYTES


class InterruptingScreen(Screen):
    """A screen whose user presses Ctrl-C at the first progress."""

    @contextmanager
    def progress(self, *_):
        def interrupt(*_):
            raise KeyboardInterrupt

        yield interrupt


def test_lost_server_while_waiting_for_a_run_prints_wait_command(closed_port, capsys):
    address = f"http://127.0.0.1:{closed_port}"

    with (
        Client(address, "secret", retry=SHORT_RETRIES) as client,
        pytest.raises(NoResponse),
    ):
        wait_for_run(client, Run.read(RUN), Screen())

    said = capsys.readouterr().err
    assert (
        "run 21 continues when the server does: `unghost wait 21` waits for it" in said
    )


CANCELLED = {"state": "cancelled"}
AGAIN = "the same command creates another"
WAIT = {
    "export": lambda client, screen: wait_for_export(
        client, Export.read(EXPORT), screen
    ),
    "run": lambda client, screen: wait_for_run(
        client, Run.read(RUN), screen, cancel=True
    ),
}


@pytest.mark.parametrize(
    ("kind", "response", "words"),
    [
        ("export", json_reply(EXPORT | CANCELLED), f"was cancelled; {AGAIN}"),
        ("export", problem(409, "export_over"), f"had ended already; {AGAIN}"),
        ("export", problem(403, "no"), f"and continues on the server; {AGAIN}"),
        ("run", json_reply(RUN | CANCELLED), "was cancelled"),
        ("run", problem(409, "run_over"), "had ended already"),
        ("run", problem(403, "no"), "could not be cancelled and continues on the"),
    ],
)
def test_interrupting_a_wait_cancels_and_says_what_became_of_it(
    scripted, client, kind, response, words
):
    job = {**EXPORT, "state": "running"} if kind == "export" else RUN
    events = f"event: progress\nid: 1\ndata: {json.dumps(job)}\n\n"
    scripted.answer(Reply(body=events.encode()), response)

    with pytest.raises(KeyboardInterrupt, match=f"{kind} {job['id']} .*{words}"):
        WAIT[kind](client, InterruptingScreen())

    path = f"/api/v1/{kind}s/{job['id']}/cancel"
    assert scripted.received_requests[-1].path == path


def test_waiting_survives_a_server_restart(scripted, client):
    silence = [Reply(hang_up=0)] * 5
    done = {**RUN, "state": "done", "done": 9}
    scripted.answer(json_reply(RUN), *silence, json_reply(done))
    scripted.answer(*silence, json_reply(EXPORT))

    assert client.wait(21, timeout_s=60).state == "done"
    assert client.wait_for_export(4, timeout_s=60).state == "done"
    assert scripted.replies == []


@pytest.mark.parametrize("end", [b"", b"\n"], ids=["one line", "many lines"])
def test_overlong_event_is_refused(scripted, client, end):
    line = b"data: " + b"x" * 1000 + end
    scripted.answer(Reply(body=line * (2 * MAX_EVENT_BYTES // len(line))))

    with pytest.raises(UnexpectedAnswer, match="has an event of more than"):
        list(client.events(21))


def test_compressed_events_are_refused(scripted, client):
    body = gzip.compress(b"event: end\ndata: {}\n\n")
    scripted.answer(Reply(body=body, headers={"Content-Encoding": "gzip"}))

    with pytest.raises(UnexpectedAnswer, match="is encoded as 'gzip'"):
        list(client.events(21))
