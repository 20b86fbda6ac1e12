"""The service asks nobody: there is no address from outside that it would fetch."""

from __future__ import annotations

import ast
import re

from tests.support.sources import CHECKOUT, python_sources

CLIENTS = {
    *("aiohttp", "ftplib", "http", "httpx", "requests", "smtplib", "telnetlib"),
    *("urllib3", "urllib", "xmlrpc", "obstore"),
}
# The store of the files is where the settings say, and nobody else says so.
STORE = {"app/storage/s3.py"}
HARMLESS = {"http": {"HTTPStatus"}, "urllib.parse": None}
# The first versions without a known hole that somebody could reach from outside.
FLOORS = {
    "starlette": (0, 49, 1),  # ranges in numbers
    "python-multipart": (0, 0, 34),  # headers of parts without end
    "h11": (0, 16),  # chunks that are none
    "defusedxml": (0, 7, 1),
}


def imported(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((name.name, {""}) for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module, {name.name for name in node.names}


def test_service_and_library_have_no_client():
    found = {
        (source.name, module)
        for source in python_sources("app", "filter_core")
        for module, names in imported(source.tree)
        if module.split(".")[0] in CLIENTS
        and not (source.name in STORE and module.split(".")[0] == "obstore")
        and not (module in HARMLESS and names <= (HARMLESS[module] or names))
    }

    assert found == set()


def test_no_route_takes_an_address():
    routes = python_sources("app")

    named = [
        source.name
        for source in routes
        if re.search(r"\b(AnyUrl|HttpUrl|AnyHttpUrl|webhook)\b", source.text)
    ]

    assert named == []


def test_dependencies_with_a_known_hole_are_not_installed():
    text = (CHECKOUT / "pyproject.toml").read_text("utf-8")

    for name, floor in FLOORS.items():
        found = re.search(rf'"{name}>=([\d.]+)', text)
        assert found is not None, name
        assert tuple(map(int, found[1].split("."))) >= floor
