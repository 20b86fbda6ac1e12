"""Reads the project's own source files, without vendored code."""

import ast
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[2]
PRODUCT = ("app", "filter_core", "unghost")
PYTHON = (*PRODUCT, "migrations", "tests", "benchmarks", "tools")
PAGE = ("static", "tests/js")
EXCLUDED_FOLDERS = frozenset({"__pycache__", "vendor", "node_modules"})


@dataclass(frozen=True)
class Source:
    """A file's path from the top of the checkout, and its text."""

    name: str
    text: str

    @property
    def lines(self) -> list[str]:
        return self.text.splitlines()

    @property
    def tree(self) -> ast.Module:
        return ast.parse(self.text, self.name)


@lru_cache
def sources(folders: tuple[str, ...], *suffixes: str) -> tuple[Source, ...]:
    """Every file with one of the suffixes below the folders, in a stable order."""
    paths = [
        path
        for folder in folders
        for path in sorted((CHECKOUT / folder).rglob("*"))
        if path.suffix in suffixes
        and path.is_file()
        and not EXCLUDED_FOLDERS & {*path.parts}
    ]
    return tuple(
        Source(path.relative_to(CHECKOUT).as_posix(), path.read_text("utf-8"))
        for path in paths
    )


@cache
def imports(source: Source) -> tuple[ast.Import | ast.ImportFrom, ...]:
    """All statements of a module that import, also those in functions."""
    return tuple(
        node
        for node in ast.walk(source.tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
    )


def python_sources(*folders: str) -> tuple[Source, ...]:
    """The Python modules of these folders, or of all folders if none is named."""
    return sources(folders or PYTHON, ".py")


def page_sources() -> tuple[Source, ...]:
    """The page's scripts, styles and markup."""
    return sources(PAGE, ".js", ".mjs", ".css", ".html")


@cache
def names_of_tests(path: str) -> frozenset[str]:
    """The names of the tests that a module defines, by its path from the checkout."""
    tree = Source(path, (CHECKOUT / path).read_text("utf-8")).tree
    return frozenset(
        node.name
        for node in tree.body
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    )
