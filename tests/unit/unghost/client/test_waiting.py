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


@pytest.mark.parametrize(
    ("response", "words"),
    [
        (json_reply({**EXPORT, "state": "cancelled"}), "was cancelled; the same"),
        (problem(409, "export_over"), "had ended already; the same"),
        (problem(403, "forbidden"), "and continues on the server; the same"),
    ],
)
def test_interrupting_wait_for_export_cancels_it_with_a_message(
    scripted, client, response, words
):
    told = json.dumps({**EXPORT, "state": "running"})
    events = f"event: progress\nid: 1\ndata: {told}\n\n"
    scripted.answer(Reply(body=events.encode()), response)

    with pytest.raises(
        KeyboardInterrupt, match=f"export 4 .*{words} command creates another"
    ):
        wait_for_export(client, Export.read(EXPORT), InterruptingScreen())

    assert scripted.received_requests[-1].path == "/api/v1/exports/4/cancel"


@pytest.mark.parametrize(
    ("response", "words"),
    [
        (json_reply({**RUN, "state": "cancelled"}), "run 21 was cancelled"),
        (problem(409, "run_over"), "run 21 had ended already"),
        (problem(403, "forbidden"), "could not be cancelled and continues on the"),
    ],
)
def test_interrupting_wait_for_run_with_cancel_says_what_became_of_it(
    scripted, client, response, words
):
    events = f"event: progress\nid: 1\ndata: {json.dumps(RUN)}\n\n"
    scripted.answer(Reply(body=events.encode()), response)

    with pytest.raises(KeyboardInterrupt, match=words):
        wait_for_run(client, Run.read(RUN), InterruptingScreen(), cancel=True)

    assert scripted.received_requests[-1].path == "/api/v1/runs/21/cancel"


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
