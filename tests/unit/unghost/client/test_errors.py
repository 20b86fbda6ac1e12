"""Each failed or unreadable answer raises the exception that describes it."""

from __future__ import annotations

import pytest

import unghost
from tests.support.scripted_server import Reply, json_reply, problem


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


def test_exception_lists_the_faults_of_the_request(scripted, client):
    faults = [{"pointer": "/boxes/3/xyxy", "code": "not_finite", "detail": "is NaN"}]
    scripted.answer(problem(422, "bad_annotation", errors=faults))

    with pytest.raises(unghost.Invalid) as caught:
        client.version()

    (fault,) = caught.value.errors
    assert fault == unghost.Fault(**faults[0])
    assert str(fault) == "/boxes/3/xyxy: is NaN"


def test_stale_review_error_has_the_current_decision(scripted, client):
    scripted.answer(problem(412, "stale_review", current={"id": "7", "box_id": 3}))

    with pytest.raises(unghost.Conflict) as caught:
        client.review(3, "keep", seen_revision=0)

    assert isinstance(caught.value, unghost.StaleReview)
    assert caught.value.current == {"id": "7", "box_id": 3}


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


def test_client_repr_does_not_contain_the_token(client):
    assert "secret" not in repr(client)
