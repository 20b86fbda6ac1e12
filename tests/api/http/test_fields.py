"""Fields, filters and orders come from fixed lists: no request can name a column."""

import re

import pytest

from tests.support import databases

HIDDEN_COLUMNS = ("hash", "token_id", "tokens", "created_by", "revoked_at")
CRAFTED = (
    *("hash", "token__hash", "tokens.hash", "-hash", "id; drop table tokens"),
    *("id'", 'id"', "id)--", "(select hash from tokens)", "created_by", "\x00"),
)
INJECTED = ("' or 1=1 --", '"; drop table tokens; --', "%_\\{}$1")


def operations(document):
    for path, item in document["paths"].items():
        for method, operation in item.items():
            yield method, path, operation


def resolved(document, schema):
    while "$ref" in schema:
        schema = document["components"]["schemas"][schema["$ref"].rpartition("/")[2]]
    return schema


def test_request_bodies_have_no_field_for_ids_authors_or_secrets_nor_unknown_ones(
    document,
):
    open_ended, named = set(), set()
    for method, path, operation in operations(document):
        content = operation.get("requestBody", {}).get("content", {})
        if "application/json" in content:
            schema = resolved(document, content["application/json"]["schema"])
            if schema.get("additionalProperties") is not False:
                open_ended.add((method, path))
            named |= set(schema.get("properties", ()))

    # A configuration has keys of its own; unknown ones are refused by its reader.
    assert open_ended == {("post", "/api/v1/datasets/{dataset}/configs")}
    assert named & {*HIDDEN_COLUMNS} == set()
    assert named & {"id", "reviewer", "revision", "created_at"} == set()


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("/datasets", {"name": "mine", "created_by": "root"}),
        ("/datasets", {"name": "mine", "id": 7}),
        ("/datasets/fields/runs", {"config": "0" * 64, "created_by": "root"}),
        ("/datasets/fields/runs", {"config": "0" * 64, "state": "done"}),
        ("/datasets/fields/exports", {"format": "yolo", "sha256": "0" * 64}),
        ("/datasets/fields/configs", {"digest": "0" * 64}),
        ("/boxes/1/reviews", {"verdict": "keep", "seen_revision": 0, "reviewer": "x"}),
        ("/tokens", {"name": "mine", "hash": "0" * 64}),
        ("/session", {"token": "ug_x", "role": "admin"}),
    ],
)
def test_an_unknown_field_of_a_body_is_refused(admin, path, body):
    admin.post("/api/v1/datasets", json={"name": "fields"})

    response = admin.post(f"/api/v1{path}", json=body)

    assert response.status_code == 422, response.text


def test_every_sort_parameter_is_an_enum(document):
    orders = [
        parameter["schema"]
        for _, _, operation in operations(document)
        for parameter in operation.get("parameters", ())
        if parameter["name"] in {"sort", "order"}
    ]

    assert orders
    assert all("enum" in resolved(document, schema) for schema in orders)


@pytest.mark.parametrize("crafted", CRAFTED)
def test_sort_by_an_unlisted_column_is_refused(admin, crafted):
    admin.post("/api/v1/datasets", json={"name": "fields"})

    responses = [
        admin.get("/api/v1/boxes", params={"dataset": "fields", "sort": crafted}),
        admin.get("/api/v1/datasets/fields/frames", params={"sort": crafted}),
        admin.post("/api/v1/datasets/fields/queue", json={"order": crafted}),
    ]

    assert {response.status_code for response in responses} == {422}


@pytest.mark.parametrize("name", ["hash", "token__hash__startswith", "created_by"])
def test_filter_on_an_unlisted_column_is_refused(admin, document, name):
    lists = {path for method, path, _ in operations(document) if method == "get"}

    statuses = {
        path: admin.get(re.sub(r"{.*?}", "1", path), params={name: "a"}).status_code
        for path in sorted(lists)
    }

    assert {path for path, status in statuses.items() if status != 400} == set()


@pytest.mark.parametrize("text", INJECTED)
def test_sql_injection_in_query_parameters_has_no_effect(
    service, admin, document, text
):
    """Every query parameter of every GET, with text that means something in SQL."""
    tokens = (service.settings.data, "select * from tokens order by 1")
    before = databases.rows_of(*tokens)

    failed = {
        (path, parameter["name"])
        for method, path, operation in operations(document)
        for parameter in operation.get("parameters", ())
        if (method, parameter["in"]) == ("get", "query")
        and admin.get(
            re.sub(r"{.*?}", "1", path), params={parameter["name"]: text}
        ).status_code
        >= 500
    }

    assert failed == set()
    assert databases.rows_of(*tokens) == before
