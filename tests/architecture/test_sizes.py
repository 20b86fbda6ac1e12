"""Nothing grows past the size at which one can still read it in one go."""

from __future__ import annotations

import ast

from tests.architecture.sources import CHECKOUT, page_sources, python_sources

MODULE_LINES = 350
FUNCTION_LINES = 40
PAGE_FILE_LINES = 300
ARCHITECTURE_LINES = 300
# "file" or "file::function" -> why it may be longer. Empty, and meant to stay so.
EXCEPTIONS: dict[str, str] = {}
# A migration is a list of statements, written once and never touched again.
FROZEN = "migrations/versions/"

Function = ast.FunctionDef | ast.AsyncFunctionDef


def too_long(sizes: dict[str, int], limit: int) -> dict[str, int]:
    """What is over the limit and neither excepted nor frozen."""
    return {
        name: lines
        for name, lines in sizes.items()
        if lines > limit and name not in EXCEPTIONS and not name.startswith(FROZEN)
    }


def functions(tree: ast.Module) -> list[Function]:
    """Every function and method, nested ones too."""
    return [node for node in ast.walk(tree) if isinstance(node, Function)]


def body_lines(function: Function) -> int:
    """Lines of the body; the docstring is free."""
    body = function.body[1:] if ast.get_docstring(function) else function.body
    return (body[-1].end_lineno or 0) - body[0].lineno + 1 if body else 0


def test_modules_stay_readable():
    sizes = {source.name: len(source.lines) for source in python_sources()}

    assert too_long(sizes, MODULE_LINES) == {}


def test_functions_stay_readable():
    sizes = {
        f"{source.name}::{function.name}": body_lines(function)
        for source in python_sources()
        for function in functions(source.tree)
    }

    assert too_long(sizes, FUNCTION_LINES) == {}


def test_page_files_stay_readable():
    sizes = {source.name: len(source.lines) for source in page_sources()}

    assert too_long(sizes, PAGE_FILE_LINES) == {}


def test_the_map_of_the_house_stays_short():
    text = (CHECKOUT / "ARCHITECTURE.md").read_text("utf-8")

    assert len(text.splitlines()) <= ARCHITECTURE_LINES


def test_no_exception_outlives_its_file():
    files = {source.name for source in (*python_sources(), *page_sources())}

    assert {name.split("::")[0] for name in EXCEPTIONS} <= files
