"""docs/api.md and the OpenAPI document name the same routes."""

from __future__ import annotations

import re

import pytest

from app.main import create_app
from app.settings import Settings
from tests.docs.documents import DOCUMENTS, read

METHODS = ("GET", "POST", "PUT", "PATCH", "DELETE")
ROW = re.compile(r"^\| ([A-Z]+) \| `(/[^`]*)` \| (.*) \|$", re.MULTILINE)
IN_PROSE = re.compile(rf"`({'|'.join(METHODS)}) (/[^`?\s]*)")


@pytest.fixture(scope="module")
def routes():
    """Method and path of every route that the service offers."""
    paths = create_app(Settings()).openapi()["paths"]
    return {
        (method.upper(), path)
        for path, operations in paths.items()
        for method in operations
    }


def shape(path):
    """A path without the names of its parameters."""
    return re.sub(r"\{[^}]*\}", "{}", path)


def test_every_route_is_listed_and_every_listed_route_exists(routes):
    listed = ROW.findall(read("docs/api.md"))

    assert {(method, path) for method, path, _ in listed} == routes
    assert [path for _, path, text in listed if not text.strip()] == []


def test_every_route_that_prose_mentions_exists(routes):
    shapes = {(method, shape(path)) for method, path in routes}
    mentioned = {
        (method, shape(path))
        for document in DOCUMENTS
        for method, path in IN_PROSE.findall(document.read_text("utf-8"))
    }

    assert mentioned <= shapes


def test_every_route_is_tagged_and_described(routes):
    paths = create_app(Settings()).openapi()["paths"]

    bare = [
        f"{method} {path}"
        for path, operations in paths.items()
        for method, operation in operations.items()
        if not operation.get("description")
    ]

    assert len(routes) > 0
    assert bare == []
