"""The events of a run: in order, at a limited rate, resumed after the last one seen."""

import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from datetime import datetime

import pytest

from tests.support.api import BASE, Api
from tests.support.databases import change
from tests.support.event_reader import events, open_events
from tests.support.live import hold_frames, live
from tests.support.run_results import post_run
from tests.support.servers import running_server
from tests.support.waiting import PATIENCE_S, until

FRAMES, SHOWN = 60, (20, 40)
"""The frames of a run, and how many are done when it waits until an event says so."""
EVERY_S = 0.2
"""The least time between two events."""


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """A client, the id of one run that measures, and all its events."""
    folder = tmp_path_factory.mktemp("seen") / "data"
    with live(folder, workers=1) as service, service.admin() as http:
        api = Api(http)
        dataset = api.dataset_of_frames(FRAMES)
        sent = []
        with hold_frames() as permits:
            run_id = post_run(api, dataset, activate=False)
            permits.release(SHOWN[0])
            with open_events(api, run_id) as stream:
                for event in (event for event in stream if event.name):
                    sent.append(event)
                    if event.data["done"] in SHOWN:
                        permits.release(SHOWN[0])
        yield api, run_id, sent


def test_run_events_show_progress_at_a_limited_rate_and_finish_with_the_end_event(seen):
    api, run_id, sent = seen
    done, last = [event.data["done"] for event in sent], sent[-1].data

    assert [event.name for event in sent][-2:] == ["progress", "end"]
    assert {event.name for event in sent[:-1]} == {"progress"}
    assert done == sorted(done)
    assert set(SHOWN) <= set(done)
    assert last == api.json(f"/runs/{run_id}")
    assert (last["state"], last["done"]) == ("done", FRAMES)
    numbers = [int(event.id) for event in sent]
    assert numbers == sorted(set(numbers))
    times = (last[name].rstrip("Z") for name in ("created_at", "finished_at"))
    begun, ended = map(datetime.fromisoformat, times)
    # By the server's times, since events may arrive late. Three may follow its end.
    assert len(sent) - 3 <= (ended - begun).total_seconds() / EVERY_S + 1


def test_run_events_resume_after_last_event_id_and_begin_again_after_an_unknown_one(
    seen,
):
    api, run_id, sent = seen
    url = f"{BASE}/runs/{run_id}/events"

    again = events(api, run_id, sent[-3].id)
    over = api.http.get(url, headers={"Last-Event-ID": sent[-1].id})

    assert [event.id for event in again] == [event.id for event in sent[-2:]]
    assert (over.status_code, over.content) == (204, b"")
    for unknown in ("", "-1", "soon", "9" * 40, "²"):
        headers = {"Last-Event-ID": unknown.encode("latin-1")}
        response = api.http.get(url, headers=headers)
        assert response.text.count("event: ") == 2, unknown
        assert f"id: {sent[-1].id}\n" in response.text


def test_run_events_follow_changes_of_the_row_by_another_process(held):
    server, api = held
    missing = api.get("/runs/999999/events")
    stranger = api.http.get(f"{BASE}/runs/1/events", headers={"Authorization": "none"})
    assert (missing.status_code, missing.json()["code"]) == (404, "not_found")
    assert stranger.status_code == 401

    _, run_id = waiting_run(server, api)
    wait_until_no_stream_is_open(api)
    with open_events(api, run_id) as stream:
        first = next(stream)
        write_row(server, run_id, "failed")
        *_, last = [event for event in stream if event.name]

    assert (first.data["state"], first.id) == ("queued", "0")
    assert (last.name, last.data["state"]) == ("end", "failed")


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    """A server that allows three streams of events, and a client of it."""
    folder = tmp_path_factory.mktemp("held") / "data"
    settings = {"UNGHOST_MAX_EVENT_STREAMS": "3", "UNGHOST_EVENT_HEARTBEAT_S": "0.3"}
    with running_server(folder, settings) as server:
        api = Api.at(server.url, server.headers)
        with api.http:
            yield server, api


def waiting_run(server, api):
    """A run that stays queued: its lease says that another process has it.

    Gives the dataset, and the id of the run.
    """
    dataset = api.dataset()
    (run,) = api.json(f"/datasets/{dataset}/runs")["items"]
    change(
        server.data,
        "INSERT INTO leases (kind, job_id, holder, until) VALUES "
        "('run', :id, 'elsewhere/1/2/3', '2999-01-01 00:00:00')",
        id=run["id"],
    )
    write_row(server, run["id"], "queued")
    return dataset, run["id"]


def write_row(server, run_id, state):
    change(
        server.data,
        "UPDATE runs SET state = :state WHERE id = :id",
        state=state,
        id=run_id,
    )


def wait_until_no_stream_is_open(api):
    """Wait until the server has noticed that earlier streams were closed."""
    none = "\nunghost_event_streams_open 0.0\n"
    until(lambda: none in api.http.get("/metrics").text, "a stream is open")


def test_event_stream_sends_heartbeats_until_its_token_is_revoked(held):
    server, api = held
    _, run_id = waiting_run(server, api)
    wait_until_no_stream_is_open(api)
    token = api.post("/tokens", {"name": "watcher", "role": "viewer"}).json()
    watcher = Api.at(server.url, {"Authorization": f"Bearer {token['token']}"})
    with watcher.http, open_events(watcher, run_id) as stream:
        sent = [next(stream), next(stream)]
        api.http.delete(f"{BASE}/tokens/{token['id']}")
        rest = list(stream)

    assert [event.name for event in sent] == ["progress", ""]
    assert {event.name for event in rest} <= {""}


def test_event_streams_are_limited_and_freed_on_disconnect(held):
    server, api = held
    _, run_id = waiting_run(server, api)
    with ExitStack() as watchers:
        streams: list[Iterator] = []

        def three_are_open():
            with suppress(AssertionError):  # an earlier stream still counts
                streams.append(watchers.enter_context(open_events(api, run_id)))
            return len(streams) == 3

        until(three_are_open)
        firsts = [next(stream) for stream in streams]
        full = api.get(f"/runs/{run_id}/events")

    assert [event.name for event in firsts] == ["progress"] * 3
    assert (full.status_code, full.headers["retry-after"]) == (429, "1")
    wait_until_no_stream_is_open(api)


def test_event_stream_of_a_deleted_run_closes_without_end_event(held):
    server, api = held
    dataset, run_id = waiting_run(server, api)
    wait_until_no_stream_is_open(api)
    with open_events(api, run_id) as stream:
        next(stream)
        api.http.delete(f"{BASE}/datasets/{dataset}", params={"confirm": dataset})
        rest = [event.name for event in stream if event.name]

    assert rest == []


def test_shutdown_does_not_wait_for_open_event_streams(start_api):
    server, api = start_api(UNGHOST_SHUTDOWN_WAIT_S="100")
    _, run_id = waiting_run(server, api)
    with open_events(api, run_id) as stream:
        next(stream)
        begun = time.monotonic()
        server.process.terminate()
        names = [event.name for event in stream]
        server.process.wait(PATIENCE_S)

    assert "end" not in names
    assert time.monotonic() - begun < 50
