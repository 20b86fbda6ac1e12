"""The document names the service's packages in order, and few modules open files."""

import ast
from typing import Final

import pytest

from tests.support.documents import names_in_rows, read
from tests.support.sources import python_sources

OPEN_FILES: Final = ("filter_core/formats/", "filter_core/local.py")
OPENING: Final = frozenset(
    {"imread", "imwrite", "fromfile", "tofile", "open"}
    | {f"{verb}_{what}" for verb in ("read", "write") for what in ("bytes", "text")}
)
"""Methods and functions of modules; `open` also by itself."""


def test_table_of_the_architecture_has_the_order_of_the_import_contract():
    settings = pytest.importorskip("tomllib").loads(read("pyproject.toml"))["tool"]
    contracts = settings["importlinter"]["contracts"]
    (layers,) = (row["layers"] for row in contracts if row.get("containers") == ["app"])
    level_of = {
        name: level
        for level, names in enumerate(layers)
        for name in names.split(" | ")
        if name != "__main__"
    }

    rows = names_in_rows(read("ARCHITECTURE.md"), "### app")
    names = [name.removesuffix("/").removesuffix(".py") for row in rows for name in row]

    assert sorted(names) == sorted(level_of)
    levels = [level_of[name] for name in names]
    assert levels == sorted(levels)


def opened_files(tree: ast.AST) -> list[int]:
    """The lines of calls that open a file, as functions or as methods of a path."""
    called = [node.func for node in ast.walk(tree) if isinstance(node, ast.Call)]
    return [
        function.lineno
        for function in called
        if getattr(function, "attr", "") in OPENING
        or getattr(function, "id", "") == "open"
    ]


def test_in_filter_core_only_formats_and_local_open_files():
    readers = {
        source.name
        for source in python_sources("filter_core")
        if opened_files(source.tree)
    }

    assert {name for name in readers if not name.startswith(OPEN_FILES)} == set()
    assert "filter_core/local.py" in readers
