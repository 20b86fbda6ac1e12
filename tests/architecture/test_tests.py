"""Tests use only public names of the product, and share helpers in two packages.

These are `tests/support` and `tests/pins`.

They never replace a name of the product, for example by `monkeypatch`. To make
something fail, they change a library, a file or a connection.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator

import pytest

from tests.support.sources import PRODUCT, Source, python_sources

REPLACE = {"setattr", "delattr", "__setattr__", "object"}
"""Functions that change an attribute of their first argument."""


def imported_names(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """(line, full dotted name) of everything that a module imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, one.name) for one in node.names)
        elif isinstance(node, ast.ImportFrom):
            for one in node.names:
                yield node.lineno, f"{node.module}.{one.name}"


def is_in_a_test_module(name: str) -> bool:
    """Whether a dotted name is that of something in a test module or a conftest."""
    return any(
        part == "conftest" or part.startswith("test_") for part in name.split(".")[:-1]
    )


def is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


def private_names_of_others(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """(line, name) of private names that a module imports, reads or patches.

    Its own attributes, such as `self._name`, do not count.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            names = [*(node.module or "").split("."), *(one.name for one in node.names)]
        elif isinstance(node, ast.Attribute) and not is_own(node.value):
            names = [node.attr]
        elif isinstance(node, ast.Call) and is_setattr(node.func):
            texts = (one.value for one in node.args if isinstance(one, ast.Constant))
            names = [str(text).rpartition(".")[2] for text in texts]
        else:
            continue
        yield from ((node.lineno, name) for name in names if is_private(name))


def is_own(value: ast.expr) -> bool:
    """Whether this is `self`, `cls` or `super()`; or `os`, because of `os._exit`."""
    if isinstance(value, ast.Call):
        value = value.func
    return isinstance(value, ast.Name) and value.id in ("self", "cls", "super", "os")


def is_setattr(function: ast.expr) -> bool:
    name = function.attr if isinstance(function, ast.Attribute) else ""
    return (function.id if isinstance(function, ast.Name) else name) == "setattr"


def replaced(tree: ast.Module) -> Iterator[int]:
    """The lines in which an attribute of something of the product is replaced."""
    ours = {
        name.asname or name.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        and (node.module or "").partition(".")[0] in PRODUCT
        for name in node.names
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and node.args:
            is_change = ast.unparse(node.func).rpartition(".")[2] in REPLACE
            changed = ast.unparse(node.args[0])
        elif isinstance(node, ast.Subscript):
            is_change = isinstance(node.ctx, ast.Store)
            changed = ast.unparse(node.value).removeprefix("vars(").removesuffix(")")
        elif isinstance(node, ast.Attribute):
            is_change = isinstance(node.ctx, ast.Store)
            changed = ast.unparse(node.value)
        else:
            continue
        if is_change and changed in ours:
            yield node.lineno


@pytest.mark.parametrize(
    "statement",
    [
        'monkeypatch.setattr(cli, "ROWS", 1)',
        'type.__setattr__(cli, "ROWS", 1)',
        'with patch.object(cli, "ROWS", 1): pass',
        'vars(cli)["ROWS"] = 1',
        "cli.ROWS = 1",
    ],
)
def test_replaced_product_name_is_detected(statement):
    source = Source("tests/test_it.py", f"from unghost import cli\n{statement}")

    assert list(replaced(source.tree)) == [2]


def test_tests_do_not_replace_names_of_the_product():
    found = [
        f"{source.name}:{line}"
        for source in python_sources("tests")
        for line in replaced(source.tree)
    ]

    assert found == []


def test_tests_use_no_private_names():
    found = [
        f"{source.name}:{line} knows {name}"
        for source in python_sources("tests", "benchmarks")
        for line, name in private_names_of_others(source.tree)
    ]

    assert found == []


def test_test_modules_and_conftests_are_never_imported():
    found = [
        f"{source.name}:{line} imports {name}"
        for source in python_sources("tests", "benchmarks", "tools")
        for line, name in imported_names(source.tree)
        if name.startswith("tests.") and is_in_a_test_module(f"{name}.")
    ]

    assert found == []


def test_tests_import_nothing_from_benchmarks():
    """Helpers that both use are in `tests/support`."""
    found = [
        f"{source.name}:{line} imports {name}"
        for source in python_sources("tests")
        for line, name in imported_names(source.tree)
        if name.partition(".")[0] == "benchmarks"
    ]

    assert found == []
