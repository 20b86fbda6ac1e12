"""Tests use only public names of the product, and share helpers in two packages.

These are `tests/support` and `tests/pins`.

They never replace a name of the product, for example by `monkeypatch`. To make
something fail, they change a library, a file or a connection.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache

import pytest

from tests.support.sources import PRODUCT, Source, python_sources
from tests.support.syntax import Class, facts, imported_names

CODE = python_sources(*PRODUCT, "tests", "benchmarks")
OF_AN_APPLICATION = re.compile(r"\.app(\.state\..+)?$")


def is_in_a_test_module(name: str) -> bool:
    """Whether a dotted name is that of something in a test module or a conftest."""
    return any(
        part == "conftest" or part.startswith("test_") for part in name.split(".")[:-1]
    )


def inherited_private_names(source: Source) -> Iterator[tuple[int, str]]:
    """(line, name) of private names that a module's classes share with the product.

    A class inherits them directly, or through other classes of tests, and reads, sets
    or overrides them.
    """
    for each in facts(source).classes:
        theirs = set().union(*map(private_names_of_product, each.bases))
        yield from ((line, name) for line, name in each.private_names if name in theirs)


@cache
def private_names_of_product(base: str) -> frozenset[str]:
    """The private names of every product class with this name or below which it is."""
    found, seen, names = set[str](), set[str](), [base]
    while names:
        name = names.pop()
        if name not in seen:
            seen.add(name)
            for is_product, each in classes_by_name().get(name, []):
                names.extend(each.bases)
                if is_product:
                    found.update(private for _, private in each.private_names)
    return frozenset(found)


@cache
def classes_by_name() -> dict[str, list[tuple[bool, Class]]]:
    """(whether it is one of the product, the class) of all classes with a name."""
    found: dict[str, list[tuple[bool, Class]]] = {}
    for source in CODE:
        is_product = source.name.partition("/")[0] in PRODUCT
        for each in facts(source).classes:
            found.setdefault(each.name, []).append((is_product, each))
    return found


def replaced(source: Source) -> Iterator[int]:
    """The lines in which an attribute of something of the product is replaced.

    That is, of something that is imported from it or named in a text, or of a
    service's application and what it contains.
    """
    ours = {
        name.asname or name.name
        for node in facts(source).imports
        for name in node.names
        if is_of_product(getattr(node, "module", None) or name.name)
    }
    for line, changed in facts(source).changed:
        text = changed.strip("'")
        is_named = text != changed and is_of_product(text)
        if is_named or changed in ours or OF_AN_APPLICATION.search(changed):
            yield line


def is_of_product(name: str) -> bool:
    """Whether a dotted name begins with a package of the product."""
    return name.partition(".")[0] in PRODUCT


@pytest.mark.parametrize(
    "statement",
    [
        'monkeypatch.setattr(cli, "ROWS", 1)',
        'type.__setattr__(cli, "ROWS", 1)',
        'with patch.object(cli, "ROWS", 1): pass',
        'vars(cli)["ROWS"] = 1',
        "cli.ROWS = 1",
        'monkeypatch.setattr(service.app, "openapi", make_slowly)',
        'monkeypatch.setattr(service.app.state.services.database, "write", wait)',
        'monkeypatch.setattr("unghost.cli.ROWS", 1)',
        "import unghost.cli; unghost.cli.ROWS = 1",
    ],
)
def test_replaced_product_name_is_detected(statement):
    source = Source("tests/test_it.py", f"from unghost import cli\n{statement}")

    assert list(replaced(source)) == [2]


def test_tests_do_not_replace_names_of_the_product():
    found = [
        f"{source.name}:{line}"
        for source in python_sources("tests")
        for line in replaced(source)
    ]

    assert found == []


def test_tests_use_no_private_names():
    found = [
        f"{source.name}:{line} knows {name}"
        for source in python_sources("tests", "benchmarks")
        for line, name in facts(source).private_names
    ]

    assert found == []


@pytest.mark.parametrize("base", ["LocalEngine", "ClusterEngine", "chunks.SmallChunks"])
@pytest.mark.parametrize(
    "member", ["run = lambda self: self._pixels", "def _busy(self): pass"]
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
        for line, name in imported_names(source)
        if name.startswith("tests.") and is_in_a_test_module(f"{name}.")
    ]

    assert found == []


def test_tests_import_nothing_from_benchmarks():
    """Helpers that both use are in `tests/support`."""
    found = [
        f"{source.name}:{line} imports {name}"
        for source in python_sources("tests")
        for line, name in imported_names(source)
        if name.partition(".")[0] == "benchmarks"
    ]

    assert found == []
