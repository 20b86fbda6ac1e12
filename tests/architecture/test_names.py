"""Names of modules and packages mean something: none is called `utils` or the like.

Also: imports are absolute, and every module of the product has a docstring.
"""

from __future__ import annotations

import ast
from pathlib import PurePath

from tests.support.sources import page_sources, python_sources
from tests.support.syntax import facts

MEANINGLESS_NAMES = frozenset(
    {"util", "utils", "helper", "helpers", "common", "misc", "manager", "managers"}
    | {"handler", "handlers", "data", "info", "stuff", "core", "base_utils"}
)


def test_no_module_has_a_meaningless_name():
    files = [source.name for source in (*python_sources(), *page_sources())]

    assert [name for name in files if PurePath(name).stem in MEANINGLESS_NAMES] == []


def test_no_package_has_a_meaningless_name():
    folders = {
        folder
        for source in (*python_sources("app", "filter_core", "unghost"),)
        for folder in PurePath(source.name).parts[:-1]
    }

    assert folders & MEANINGLESS_NAMES == set()


def test_imports_are_absolute():
    relative = [
        f"{source.name}:{node.lineno}"
        for source in python_sources()
        for node in facts(source).imports
        if isinstance(node, ast.ImportFrom) and node.level
    ]

    assert relative == []


def test_every_module_has_a_docstring():
    silent = [
        source.name
        for source in python_sources("app", "filter_core", "unghost")
        if source.text.strip() and not facts(source).has_docstring
    ]

    assert silent == []
