"""Tests use only public names of the product, and share helpers in two packages.

These are `tests/support` and `tests/pins`.

They never replace a name of the product, for example by `monkeypatch`. To make
something fail, they change a library, a file or a connection.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache

import pytest

from tests.support.sources import PRODUCT, Source, python_sources

CODE = python_sources(*PRODUCT, "tests", "benchmarks")

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

    Attributes of `self` do not count: see `inherited_private_names`.
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


def inherited_private_names(source: Source) -> Iterator[tuple[int, str]]:
    """(line, name) of private names that a module's classes share with the product.

    A class inherits them directly, or through other classes of tests, and reads, sets
    or overrides them.
    """
    for node in classes_of(source):
        theirs = set().union(*map(private_names_of_product, base_names(node)))
        yield from (
            (line, name) for line, name in private_names(node) if name in theirs
        )


@cache
def private_names_of_product(base: str) -> frozenset[str]:
    """The private names of every product class with this name or below which it is."""
    found, seen, names = set[str](), set[str](), [base]
    while names:
        name = names.pop()
        if name not in seen:
            seen.add(name)
            for is_product, node in classes_by_name().get(name, []):
                names.extend(base_names(node))
                if is_product:
                    found.update(private for _, private in private_names(node))
    return frozenset(found)


@cache
def classes_by_name() -> dict[str, list[tuple[bool, ast.ClassDef]]]:
    """(whether it is one of the product, the class) of all classes with a name."""
    found: dict[str, list[tuple[bool, ast.ClassDef]]] = {}
    for source in CODE:
        is_product = source.name.partition("/")[0] in PRODUCT
        for node in classes_of(source):
            found.setdefault(node.name, []).append((is_product, node))
    return found


def classes_of(source: Source) -> Iterator[ast.ClassDef]:
    return (node for node in ast.walk(source.tree) if isinstance(node, ast.ClassDef))


def base_names(node: ast.ClassDef) -> Iterator[str]:
    """The names of a class's bases, without modules and type parameters."""
    for base in node.bases:
        yield ast.unparse(base).partition("[")[0].rpartition(".")[2]


def private_names(node: ast.ClassDef) -> Iterator[tuple[int, str]]:
    """(line, name) of the private names that a class has of itself."""
    for part in ast.walk(node):
        if isinstance(part, ast.FunctionDef):
            name = part.name
        elif isinstance(part, ast.Attribute) and is_own(part.value):
            name = part.attr
        elif isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store):
            name = part.id
        else:
            continue
        if is_private(name):
            yield part.lineno, name


def is_own(value: ast.expr) -> bool:
    """Whether this is `self`, `cls` or `super()`; or `os`, because of `os._exit`."""
    if isinstance(value, ast.Call):
        value = value.func
    return isinstance(value, ast.Name) and value.id in ("self", "cls", "super", "os")


def is_setattr(function: ast.expr) -> bool:
    name = function.attr if isinstance(function, ast.Attribute) else ""
    return (function.id if isinstance(function, ast.Name) else name) == "setattr"


def replaced(tree: ast.Module) -> Iterator[int]:
    """The lines in which an attribute of something of the product is replaced.

    That is, of something that is imported from it, or of a service's application.
    """
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
        if is_change and (changed in ours or changed.endswith(".app")):
            yield node.lineno


@pytest.mark.parametrize(
    "statement",
    [
        'monkeypatch.setattr(cli, "ROWS", 1)',
        'type.__setattr__(cli, "ROWS", 1)',
        'with patch.object(cli, "ROWS", 1): pass',
        'vars(cli)["ROWS"] = 1',
        "cli.ROWS = 1",
        'monkeypatch.setattr(service.app, "openapi", make_slowly)',
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


@pytest.mark.parametrize("base", ["LocalEngine", "ClusterEngine", "chunks.SmallChunks"])
@pytest.mark.parametrize(
    "member", ["run = lambda self: self._chunks", "def _begin(self): pass"]
)
def test_inherited_private_name_is_detected(base, member):
    source = Source("tests/test_it.py", f"class Mine({base}):\n    {member}")

    assert [line for line, _ in inherited_private_names(source)] == [2]


def test_tests_use_no_private_names_that_they_inherit():
    found = [
        f"{source.name}:{line} knows {name}"
        for source in python_sources("tests", "benchmarks")
        for line, name in inherited_private_names(source)
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
