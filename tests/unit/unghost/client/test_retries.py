"""The client repeats a call only if that is safe and may help."""

from __future__ import annotations

import json
import time
from datetime import datetime, timezone

import pytest

from tests.support.scripted_server import SHORT_RETRIES, Reply, json_reply, problem
from unghost import Client, NoResponse, NotFound, RetryPolicy, Unavailable
from unghost.client.errors import retry_after_s

RUN = {"id": 1, "dataset": "town", "kind": "decide", "state": "queued", "config": ""}
RUN |= {"activate": False, "total": 9, "done": 0, "changed": 0, "created_by": "ada"}
RUN |= {"created_at": "2026-01-01T00:00:00Z"}


def test_busy_server_is_retried(scripted, client):
    scripted.answer(problem(503, "database_busy"), json_reply({"version": "1"}))

    assert client.version().version == "1"


def test_lost_response_is_retried(scripted, client):
    lost = Reply(body=b'{"version": "1"}', hang_up=4)
    scripted.answer(lost, json_reply({"version": "1"}))

    assert client.version().version == "1"


def test_retries_end_after_their_time_with_the_last_error(scripted):
    scripted.answer_always(problem(503, "database_busy"))

    with (
        Client(scripted.url, "secret", retry=SHORT_RETRIES) as client,
        pytest.raises(Unavailable, match="it is database_busy; gave up after 0 s"),
    ):
        client.version()
    assert len(scripted.received_requests) > 2


def test_client_without_time_for_retries_asks_once(scripted):
    scripted.answer_always(problem(503, "database_busy"))

    with (
        Client(scripted.url, "secret", retry_for=0) as client,
        pytest.raises(Unavailable, match=r"it is database_busy$"),
    ):
        client.version()
    assert len(scripted.received_requests) == 1


def test_long_outage_is_logged_once(scripted, caplog):
    busy = Reply(503, b"{}", {"Retry-After": "1"})
    scripted.answer(busy, busy, busy, json_reply({"version": "1"}))
    retry = RetryPolicy(base_s=0.001)

    with Client(scripted.url, "secret", retry=retry) as client:
        client.version()

    (said,) = [record.getMessage() for record in caplog.records]
    assert said.startswith(f"{scripted.url}/version answered 503 without a reason; ")
    assert "trying again for up to 119 s" in said


def test_retried_post_has_the_same_idempotency_key(scripted, client):
    scripted.answer(problem(503, "database_busy"), json_reply(RUN, 202))

    client.start_run("town", {}, activate=False)

    keys = [asked.headers["Idempotency-Key"] for asked in scripted.received_requests]
    assert len(keys) == 2
    assert len(set(keys)) == 1


def test_deletion_whose_response_was_lost_is_successful(scripted, client):
    scripted.answer(Reply(hang_up=0), problem(404, "not_found"))

    client.delete_dataset("town")

    assert len(scripted.received_requests) == 2


def test_deletion_of_what_never_existed_raises_not_found(scripted, client):
    scripted.answer(problem(503, "database_busy"), problem(404, "not_found"))

    with pytest.raises(NotFound):
        client.delete_dataset("town")


@pytest.mark.parametrize(
    "call",
    [
        lambda client: client.create_token("ada"),
        lambda client: client.create_login_code(),
        lambda client: client.change_dataset("town", description="x"),
    ],
    ids=["token", "login code", "change"],
)
def test_call_whose_second_execution_would_harm_is_not_sent_again(
    scripted, client, call
):
    scripted.answer(problem(503, "database_busy"), Reply(hang_up=0))

    with pytest.raises(NoResponse):
        call(client)

    # The first was refused before anything was done.
    assert len(scripted.received_requests) == 2


def test_events_continue_after_a_busy_server(scripted, client):
    state = json.dumps({**RUN, "state": "done"})
    events = f"event: progress\nid: 1\ndata: {state}\n\nevent: end\ndata: {{}}\n\n"
    scripted.answer(problem(503, "too_many_streams"), Reply(body=events.encode()))

    assert [run.state for run in client.events(1)] == ["done"]


def test_separate_posts_have_different_idempotency_keys(scripted, client):
    scripted.answer(json_reply(RUN, 202), json_reply(RUN, 202))

    client.start_run("town", {})
    client.start_run("town", {})

    assert (
        len({asked.headers["Idempotency-Key"] for asked in scripted.received_requests})
        == 2
    )


def test_internal_server_error_is_not_retried(scripted, client):
    scripted.answer(problem(500, "internal"))

    with pytest.raises(Exception, match="it is internal"):
        client.version()
    assert len(scripted.received_requests) == 1


def test_retry_waits_for_the_retry_after_header(scripted):
    scripted.answer(
        Reply(503, b"{}", {"Retry-After": "1"}), json_reply({"version": "1"})
    )
    started = time.monotonic()

    with Client(scripted.url, retry=RetryPolicy(base_s=0.001)) as client:
        client.version()

    assert time.monotonic() - started >= 1


@pytest.mark.parametrize("user", ["", "ann:secret@"])
def test_unreachable_server_is_named_without_a_password(closed_port, user):
    address = f"127.0.0.1:{closed_port}"
    with (
        Client(f"http://{user}{address}", retry=SHORT_RETRIES) as client,
        pytest.raises(NoResponse) as caught,
    ):
        client.version()

    assert str(caught.value).startswith(f"no response from http://{address}: [Errno ")
    assert "secret" not in str(caught.value)
    assert (caught.value.address, caught.value.sent) == (f"http://{address}", False)


def test_unreachable_server_is_named_once_where_an_answer_is_streamed(closed_port):
    url = f"http://127.0.0.1:{closed_port}"
    with (
        Client(url, retry=SHORT_RETRIES) as client,
        pytest.raises(NoResponse) as caught,
    ):
        next(client.events(1))

    assert str(caught.value).count("no response from") == 1


def test_readiness_check_is_not_retried(scripted, client):
    scripted.answer(problem(503, "not_ready"))

    assert client.ready() is False
    assert len(scripted.received_requests) == 1


@pytest.mark.parametrize(
    ("header", "seconds"),
    [
        pytest.param("7", 7.0, id="seconds"),
        pytest.param("Thu, 01 Jan 2026 00:00:30 GMT", 30.0, id="date"),
        pytest.param("Wed, 31 Dec 2025 00:00:00 GMT", 0.0, id="date that has passed"),
        pytest.param("soon", None, id="not readable"),
        pytest.param(None, None, id="absent"),
    ],
)
def test_retry_after_header_is_parsed_as_seconds_or_date(header, seconds):
    now = datetime(2026, 1, 1, tzinfo=timezone.utc)

    assert retry_after_s(header, now) == seconds


def test_retry_delays_grow_with_jitter_up_to_a_maximum():
    policy = RetryPolicy(base_s=1.0, longest_s=4.0)

    delays = {attempt: _sample_delays(policy, attempt) for attempt in (1, 3, 9)}

    assert max(delays[1]) <= 1.0 < max(delays[3]) <= 4.0
    assert max(delays[9]) <= 4.0
    assert len(set(delays[9])) > 100


def test_retry_after_is_a_minimum_delay_and_is_capped():
    policy = RetryPolicy(base_s=1.0, longest_s=20.0)

    assert 5.0 <= policy.delay_s(1, 5.0) <= 6.0
    assert policy.delay_s(1, 3600.0) == 20.0


def _sample_delays(policy: RetryPolicy, attempt: int) -> list[float]:
    return [policy.delay_s(attempt) for _ in range(200)]
