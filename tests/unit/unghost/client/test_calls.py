"""The client's methods: docstrings, parameters, pages, and unreadable answers."""

import inspect

import pytest

from tests.support.response_checks import DATASET
from tests.support.scripted_server import json_reply, problem
from unghost import Client, Invalid, InvalidName, UnexpectedAnswer

METHODS = [name for name in dir(Client) if not name.startswith("_")]


@pytest.mark.parametrize("name", METHODS)
def test_client_methods_have_docstring_and_return_annotation(name):
    method = getattr(Client, name)
    result = str(inspect.signature(method).return_annotation)

    assert inspect.isfunction(method)
    assert method.__name__ == name
    assert inspect.getdoc(method)
    assert not result.startswith(("Call[", "Listing["))


def test_query_parameters_are_encoded_for_the_api(scripted, client):
    scripted.answer(json_reply({"items": []}), json_reply({"items": []}))

    list(client.boxes("town", cursor="here", limit=2))
    list(client.boxes("town", class_name="car", toss_up=True, reason=None, id=["a", 1]))

    first, second = scripted.received_requests
    assert first.path == "/api/v1/boxes?limit=2&dataset=town&cursor=here"
    assert second.path == (
        "/api/v1/boxes?limit=500&dataset=town&class=car&toss_up=true&id=a%2C1"
    )


@pytest.mark.parametrize(
    "call",
    [
        lambda client: client.delete_frame("town", "../../../tokens/1"),
        lambda client: client.frame_by_key("town", "a//b"),
        lambda client: client.stats(".."),
        lambda client: client.dataset(""),
        lambda client: client.config(".."),
        lambda client: client.frame("../tokens"),
    ],
)
def test_name_that_leads_to_another_address_is_refused_before_sending(
    scripted, client, call
):
    with pytest.raises(InvalidName, match="is no address"):
        call(client)

    assert scripted.received_requests == []


def test_frame_file_of_an_unknown_kind_raises_type_error(scripted, client):
    with pytest.raises(TypeError, match="is not a file of a frame"):
        client.frame_file(1, "../../session")

    assert scripted.received_requests == []


def test_empty_annotation_is_sent_as_it_is(scripted, client):
    scripted.answer(problem(422, "invalid_annotation"))

    with pytest.raises(Invalid):
        client.put_frame("town", "a", {})

    assert b"\r\n\r\n{}\r\n" in scripted.received_requests[0].body


def test_pagination_requests_next_page_after_the_previous_one(scripted, client):
    a, b, c = [{**DATASET, "name": name} for name in "abc"]
    page = {"items": [a, b], "next_cursor": "after b"}
    scripted.answer(json_reply(page), json_reply({"items": [c]}))

    datasets = client.datasets()
    assert scripted.received_requests == []
    first = [next(datasets).name, next(datasets).name]
    requests = len(scripted.received_requests)

    assert (first, requests) == (["a", "b"], 1)
    assert [dataset.name for dataset in datasets] == ["c"]
    assert (
        scripted.received_requests[1].path
        == "/api/v1/datasets?limit=500&cursor=after+b"
    )


@pytest.mark.parametrize(
    ("ask", "body"),
    [
        pytest.param(lambda c: c.version(), {}, id="a key is missing"),
        pytest.param(lambda c: c.count_boxes("a"), {"total": None}, id="no number"),
        pytest.param(lambda c: c.select_boxes("a"), {"total": 1}, id="no snapshot"),
        pytest.param(lambda c: next(c.datasets()), {"items": ["a"]}, id="no object"),
        pytest.param(
            lambda c: next(c.audit()),
            {
                "items": [
                    {"id": 1, "actor": "a", "action": "b", "subject": "c"}
                    | {"created_at": "yesterday"}
                ]
            },
            id="no time",
        ),
    ],
)
def test_unreadable_response_raises_unexpected_answer(scripted, client, ask, body):
    scripted.answer(json_reply(body))

    with pytest.raises(UnexpectedAnswer, match=f"the response of {scripted.url}/"):
        ask(client)
