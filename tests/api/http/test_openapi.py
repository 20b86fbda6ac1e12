"""The OpenAPI document is complete: errors, parameters and authentication."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from fastapi import FastAPI

from app.http.problems import PROBLEM_TYPE
from filter_core.annotation.boxes import KNOWN_BOX_KEYS
from filter_core.annotation.parsing import KNOWN_FRAME_KEYS
from tests.support import plain_http


@pytest.fixture(scope="module")
def schema(service):
    with service.admin() as client:
        return client.get("/openapi.json").json()


@pytest.fixture(scope="module")
def operations(schema):
    return {
        (method, path): operation
        for path, item in schema["paths"].items()
        for method, operation in item.items()
    }


def formats(node):
    if isinstance(node, dict):
        if isinstance(node.get("format"), str):
            yield node["format"]
        for value in node.values():
            yield from formats(value)
    if isinstance(node, list):
        for value in node:
            yield from formats(value)


def resolve(schema, reference):
    assert reference.startswith("#/")
    for step in reference[2:].split("/"):
        schema = schema[step.replace("~1", "/").replace("~0", "~")]
    return schema


def test_other_requests_are_answered_while_the_document_is_built(serve, monkeypatch):
    service = serve()
    service.app.openapi_schema = None
    make = FastAPI.openapi
    begun, let_go = threading.Event(), threading.Event()

    def make_slowly(app):
        begun.set()
        assert let_go.wait(60)
        return make(app)

    monkeypatch.setattr(FastAPI, "openapi", make_slowly)
    with service.admin() as client, ThreadPoolExecutor() as pool:
        document = pool.submit(client.get, "/openapi.json")
        try:
            assert begun.wait(60)
            other = client.get("/healthz").status_code
        finally:
            let_go.set()

    assert (other, document.result().status_code) == (200, 200)


def test_the_document_and_its_page_need_no_token(schema, service):
    with plain_http.Client(base_url=service.url) as client:
        assert client.get("/openapi.json").json() == schema
        page = client.get("/docs").text

    # An object of a body, a field of it, its type, its meaning and an example.
    assert '<details id="ReviewIn">' in page
    assert "<td>looked_ms, optional</td><td>integer or null</td>" in page
    assert "Name of the dataset. Example: &quot;town10&quot;" in page
    assert "<td><code>next_cursor</code> of the page before this one.</td>" in page
    errors = "400, 401, 403, 404, 408, 421, 422, 429, 431, 500, 503"
    assert f"<td>{errors}</td><td>An error.</td><td>Problem</td>" in page


def test_every_field_and_parameter_is_described_and_no_field_has_a_default(
    schema, operations
):
    """A default would become a required field of a generated client."""
    fields = {
        f"{name}.{field}": of_field
        for name, model in schema["components"]["schemas"].items()
        for field, of_field in model.get("properties", {}).items()
    }
    parameters = {
        f"{where} {parameter['name']}": parameter
        for where, operation in operations.items()
        for parameter in operation.get("parameters", ())
        if not where[1].startswith(("/probe", "/open/"))
    }

    assert len(fields) > 500
    bare = {
        name
        for name, described in {**fields, **parameters}.items()
        if not described.get("description")
    }
    assert {name for name in bare if not name.startswith("Note.")} == set(), "probes"
    assert [name for name, field in fields.items() if "default" in field] == []


def test_the_schema_of_an_annotation_has_the_keys_that_the_library_reads(schema):
    schemas = schema["components"]["schemas"]

    assert set(schemas["Annotation"]["properties"]) == KNOWN_FRAME_KEYS
    assert set(schemas["AnnotatedBox"]["properties"]) == KNOWN_BOX_KEYS


def test_every_route_declares_its_errors_and_every_post_an_idempotency_key(
    schema, operations
):
    for (method, _), operation in operations.items():
        expected = {"400", "404", "421", "422", "500", "503"}
        if "security" in operation:
            expected |= {"401", "403"}
        if method != "get":
            expected |= {"409", "412", "413", "415", "429"}
        assert expected <= operation["responses"].keys()
        for status, response in operation["responses"].items():
            if int(status) >= 400:
                content = resolve(schema, response["$ref"])["content"]
                assert list(content) == [PROBLEM_TYPE]
        names = [parameter["name"] for parameter in operation.get("parameters", ())]
        assert ("Idempotency-Key" in names) == (method == "post")


def test_every_operation_has_a_unique_id_and_a_description(operations):
    ours = [
        operation
        for (_, path), operation in operations.items()
        if not path.startswith(("/probe", "/open/"))
    ]

    names = [operation["operationId"] for operation in ours]
    assert len(set(names)) == len(names)
    assert [
        route["operationId"] for route in ours if not route.get("description")
    ] == []


def test_no_route_takes_a_url(schema, operations):
    assert "webhooks" not in schema
    assert [where for where, route in operations.items() if "callbacks" in route] == []
    assert set(formats(schema)) & {"uri", "uri-reference", "iri", "url"} == set()
