"""The client repeats a call only if that is safe and may help."""

import json
import time
from datetime import datetime, timezone

import pytest

from tests.support.response_checks import RUN
from tests.support.scripted_server import SHORT_RETRIES, Reply, json_reply, problem
from unghost import Client, NoResponse, NotFound, RetryPolicy, ServerFault, Unavailable
from unghost.client.errors import retry_after_s


@pytest.mark.parametrize(
    ("first", "seconds"),
    [
        pytest.param(problem(503, "database_busy"), 0, id="busy"),
        pytest.param(Reply(body=b'{"version": "1"}', hang_up=4), 0, id="lost"),
        pytest.param(Reply(503, b"{}", {"Retry-After": "1"}), 1, id="asks to wait"),
    ],
)
def test_request_without_an_answer_is_repeated(scripted, first, seconds):
    scripted.answer(first, json_reply({"version": "1"}))
    started = time.monotonic()

    with Client(scripted.url, retry=RetryPolicy(base_s=0.001)) as client:
        assert client.version().version == "1"

    assert time.monotonic() - started >= seconds


@pytest.mark.parametrize(
    ("options", "words", "is_repeated"),
    [
        ({"retry": SHORT_RETRIES}, "it is database_busy; gave up after 0 s", True),
        ({"retry_for": 0}, "it is database_busy$", False),
    ],
)
def test_retries_end_after_their_time_with_the_last_error(
    scripted, options, words, is_repeated
):
    scripted.answer_always(problem(503, "database_busy"))

    with (
        Client(scripted.url, "secret", **options) as client,
        pytest.raises(Unavailable, match=words),
    ):
        client.version()
    count = len(scripted.received_requests)
    assert count > 1 if is_repeated else count == 1


def test_long_outage_is_logged_once(scripted, caplog):
    busy = Reply(503, b"{}", {"Retry-After": "1"})
    scripted.answer(busy, busy, busy, json_reply({"version": "1"}))
    retry = RetryPolicy(base_s=0.001)

    with Client(scripted.url, "secret", retry=retry) as client:
        client.version()

    (said,) = [record.getMessage() for record in caplog.records]
    assert said.startswith(f"{scripted.url}/version answered 503 without a reason; ")
    assert "trying again for up to 119 s" in said


def test_only_a_repeated_post_has_the_idempotency_key_of_the_one_before(
    scripted, client
):
    busy, accepted = problem(503, "database_busy"), json_reply(RUN, 202)
    scripted.answer(busy, accepted, accepted)

    client.start_run("town", {}, activate=False)
    client.start_run("town", {})

    requests = scripted.received_requests
    first, again, other = (each.headers["Idempotency-Key"] for each in requests)
    assert first == again != other


def test_deletion_without_a_trace_is_successful_only_if_a_response_was_lost(
    scripted, client
):
    scripted.answer(Reply(hang_up=0), problem(404, "not_found"))
    client.delete_dataset("town")
    assert len(scripted.received_requests) == 2

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


@pytest.mark.parametrize("user", ["", "ann:secret@"])
@pytest.mark.parametrize(
    "call", [lambda client: client.version(), lambda client: next(client.events(1))]
)
def test_unreachable_server_is_named_once_without_a_password(closed_port, user, call):
    address = f"127.0.0.1:{closed_port}"
    with (
        Client(f"http://{user}{address}", retry=SHORT_RETRIES) as client,
        pytest.raises(NoResponse) as caught,
    ):
        call(client)

    text = str(caught.value)
    assert text.startswith(f"no response from http://{address}: [Errno ")
    assert text.count("no response from") == 1
    assert "secret" not in text
    assert (caught.value.address, caught.value.sent) == (f"http://{address}", False)


def test_internal_error_and_readiness_check_are_not_retried(scripted, client):
    scripted.answer(problem(500, "internal"), problem(503, "not_ready"))

    with pytest.raises(ServerFault, match="it is internal"):
        client.version()
    assert client.ready() is False
    assert len(scripted.received_requests) == 2


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

    first, third, ninth = (
        [policy.delay_s(attempt) for _ in range(200)] for attempt in (1, 3, 9)
    )

    assert max(first) <= 1.0 < max(third) <= 4.0
    assert max(ninth) <= 4.0
    assert len(set(ninth)) > 100
    # The server's Retry-After is a minimum, up to the longest delay.
    assert 3.0 <= policy.delay_s(1, 3.0) <= 4.0
    assert policy.delay_s(1, 3600.0) == 4.0
