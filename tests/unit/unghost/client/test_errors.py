"""Each failed or unreadable answer raises the exception that describes it."""

import gzip
import json
from contextlib import closing

import pytest

import unghost
from tests.support.scripted_server import QUICK_RETRIES, Reply, json_reply, problem
from unghost.client.call import Call, content
from unghost.client.discovery import find_server
from unghost.client.transport import Transport


@pytest.mark.parametrize(
    ("status", "kind"),
    [
        (400, unghost.BadRequest),
        (401, unghost.Unauthorized),
        (403, unghost.Forbidden),
        (404, unghost.NotFound),
        (409, unghost.Conflict),
        (412, unghost.StaleReview),
        (413, unghost.TooLarge),
        (415, unghost.Invalid),
        (422, unghost.Invalid),
        (500, unghost.ServerFault),
        (418, unghost.ApiError),
    ],
)
def test_each_http_status_raises_its_exception(scripted, client, status, kind):
    scripted.answer(problem(status, "some_code", request_id="r1"))

    with pytest.raises(unghost.ApiError) as caught:
        client.version()

    error = caught.value
    assert type(error) is kind
    assert (error.status, error.code, error.request_id) == (status, "some_code", "r1")
    assert str(error) == error.detail == "it is some_code"
    assert "secret" not in repr(client)


def test_exception_has_the_faults_of_the_request_or_the_decision(scripted, client):
    faults = [{"pointer": "/boxes/3/xyxy", "code": "not_finite", "detail": "is NaN"}]
    scripted.answer(problem(422, "bad_annotation", errors=faults))

    with pytest.raises(unghost.Invalid) as caught:
        client.version()

    (fault,) = caught.value.errors
    assert fault == unghost.Fault(**faults[0])
    assert str(fault) == "/boxes/3/xyxy: is NaN"
    scripted.answer(problem(412, "stale_review", current={"id": "7", "box_id": 3}))

    with pytest.raises(unghost.Conflict) as refused:
        client.review(3, "keep", seen_revision=0)

    assert isinstance(refused.value, unghost.StaleReview)
    assert refused.value.current == {"id": "7", "box_id": 3}


@pytest.mark.parametrize(
    "reply",
    [
        pytest.param(Reply(404, b"<h1>nginx</h1>"), id="another server's page"),
        pytest.param(json_reply({"error": "no"}, 403), id="another program's JSON"),
        pytest.param(Reply(200, b"<h1>login</h1>"), id="a page instead of JSON"),
        pytest.param(json_reply(["1"]), id="JSON, but no object"),
        pytest.param(json_reply({"release": "1"}), id="an object without the key"),
        pytest.param(Reply(302, b"", {"Location": "/login"}), id="a redirect"),
    ],
)
def test_response_that_is_not_from_unghost_raises_unexpected_answer(
    scripted, client, reply
):
    scripted.answer(reply)

    with pytest.raises(unghost.UnexpectedAnswer, match=scripted.url):
        client.version()


@pytest.mark.parametrize("status", [200, 403])
def test_compressed_response_is_refused_and_not_decompressed(scripted, client, status):
    body = {"version": "1", "code": "some_code", "detail": "x" * 100_000}
    packed = gzip.compress(json.dumps(body).encode())
    scripted.answer(Reply(status, packed, {"Content-Encoding": "gzip"}))

    with pytest.raises(unghost.UnexpectedAnswer, match="is encoded as 'gzip'"):
        client.version()

    assert scripted.received_requests[0].headers["Accept-Encoding"] == "identity"


@pytest.fixture
def transport(scripted):
    server = find_server(scripted.url, "secret")
    with closing(Transport(server, timeout=60, retry=QUICK_RETRIES)) as made:
        yield made


def test_response_or_refusal_over_the_limit_of_its_call_is_refused(scripted, transport):
    scripted.answer(*(Reply(200, bytes(size)) for size in (1000, 1001)))
    scripted.answer(problem(403, "some_code", more="x" * 1000))
    call = Call("GET", "/file", content, max_bytes=1000)

    assert transport.send(call) == bytes(1000)
    for _ in range(2):
        with pytest.raises(unghost.UnexpectedAnswer, match="is longer than 1000 bytes"):
            transport.send(call)
