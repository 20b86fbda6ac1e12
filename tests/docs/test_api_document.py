"""docs/api.md lists the routes of the OpenAPI document, and its examples are right."""

import json
import re

from app.main import create_app
from app.settings import Settings
from tests.support import plain_http
from tests.support.documents import DOCUMENTS, blocks, read

METHODS = ("GET", "POST", "PUT", "PATCH", "DELETE")
ROW = re.compile(r"^\| ([A-Z]+) \| `(/[^`]*)` \| (.*) \|$", re.MULTILINE)
IN_PROSE = re.compile(rf"`({'|'.join(METHODS)}) (/[^`?\s]*)")


def shape(path):
    """A path with `{}` in place of each parameter, to compare paths."""
    return re.sub(r"\{[^}]*\}", "{}", path)


def test_routes_are_those_that_the_documents_list_and_mention():
    paths = create_app(Settings()).openapi()["paths"]
    routes = {
        (method.upper(), path)
        for path, operations in paths.items()
        for method in operations
    }
    listed = ROW.findall(read("docs/api.md"))

    assert {(method, path) for method, path, _ in listed} == routes
    assert [path for _, path, text in listed if not text.strip()] == []
    shapes = {(method, shape(path)) for method, path in routes}
    mentioned = {
        (method, shape(path))
        for document in DOCUMENTS
        for method, path in IN_PROSE.findall(document.read_text("utf-8"))
    }

    assert mentioned <= shapes


def test_example_of_an_error_equals_the_response_of_the_server(start_server):
    server = start_server()
    shown, *_ = (json.loads(block) for block in blocks(read("docs/api.md"), "json"))
    boxes = '{"class": "car", "xyxy": [%s]}'
    good, bad = boxes % "1, 2, 3, 4", boxes % "1, 2, NaN, 4"
    annotation = f'{{"boxes": [{good}, {bad[:-1]}, "id": "217"}}]}}'

    with plain_http.Client(base_url=server.url, headers=server.headers) as client:
        client.post("/api/v1/datasets", json={"name": "town10"})
        files = {"annotation": ("annotation.json", annotation, "application/json")}
        problem = client.put(shown["instance"], files=files).json()

    # The title is Python's name of the status, which newer Pythons changed for 422.
    for of_the_moment in ("request_id", "title"):
        assert shown.pop(of_the_moment)
        assert problem.pop(of_the_moment)
    assert problem == shown
