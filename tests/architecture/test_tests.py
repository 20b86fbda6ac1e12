"""What tests may know: the product's public names, and helpers in `tests/support`."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from tests.support.sources import python_sources


def imported(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """The line and the full dotted name of everything that a module imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, one.name) for one in node.names)
        elif isinstance(node, ast.ImportFrom):
            for one in node.names:
                yield node.lineno, f"{node.module}.{one.name}"


def is_of_pytest(name: str) -> bool:
    """Whether a dotted name leads into a file that pytest collects."""
    return any(
        part == "conftest" or part.startswith("test_") for part in name.split(".")[:-1]
    )


def is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


def of_others(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Private names that a module imports, reads off something else, or patches."""
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
    """Whether this is `self`, `cls` or `super()`; `os._exit` has no other name."""
    if isinstance(value, ast.Call):
        value = value.func
    return isinstance(value, ast.Name) and value.id in ("self", "cls", "super", "os")


def is_setattr(function: ast.expr) -> bool:
    name = function.attr if isinstance(function, ast.Attribute) else ""
    return (function.id if isinstance(function, ast.Name) else name) == "setattr"


def test_tests_know_no_private_names():
    found = [
        f"{source.name}:{line} knows {name}"
        for source in python_sources("tests", "benchmarks")
        for line, name in of_others(source.tree)
    ]

    assert found == []


def test_nobody_imports_a_test_or_a_conftest():
    found = [
        f"{source.name}:{line} imports {name}"
        for source in python_sources("tests", "benchmarks", "tools")
        for line, name in imported(source.tree)
        if name.startswith("tests.") and is_of_pytest(f"{name}.")
    ]

    assert found == []
