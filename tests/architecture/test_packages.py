"""A package of the service imports only packages below it, and few modules open files.

A module directly below `app` counts as a package.
"""

from __future__ import annotations

import ast
from typing import Final

from tests.support.documents import names_in_rows, read
from tests.support.sources import python_sources
from tests.support.syntax import facts

LEVELS: Final = (
    {"__main__"},
    {"serve"},
    {"main"},
    {"ops", "datasets"},
    {"ingest"},
    {"review", "quality", "process"},
    {"hooks"},
    {"exports"},
    {"runs"},
    {"boxes"},
    {"jobs"},
    {"access"},
    {"http", "maintenance"},
    {"measuring"},
    {"catalog"},
    {"background"},
    {"context"},
    {"storage"},
    {"engine"},
    {"settings", "verdicts"},
    {"db"},
    {"incoming", "metrics"},
    {"addresses", "errors", "logs", "memory", "package", "security"},
)
"""The packages from the top down: each may import only those of the lines below it."""
OPEN_FILES: Final = ("filter_core/formats/", "filter_core/local.py")
OPENING: Final = frozenset(
    {"imread", "imwrite", "fromfile", "tofile", "open"}
    | {f"{verb}_{what}" for verb in ("read", "write") for what in ("bytes", "text")}
)
"""Methods and functions of modules; `open` also by itself."""


def package_of(module: str) -> str:
    """The package of a module: the part of its name after `app`; empty for `app`."""
    return module.partition(".")[2].partition(".")[0]


def imports_between_packages() -> set[tuple[str, str]]:
    """(importing package, imported one) of all imports, also those in functions."""
    pairs = set()
    for source in python_sources("app"):
        mine = package_of(source.name.removesuffix(".py").replace("/", "."))
        for node in facts(source).imports:
            if isinstance(node, ast.Import):
                modules = [alias.name for alias in node.names]
            elif node.module:
                named = [f"{node.module}.{alias.name}" for alias in node.names]
                modules = named if node.module == "app" else [node.module]
            else:
                continue
            others = {package_of(name) for name in modules if name.startswith("app.")}
            pairs |= {(mine, other) for other in others - {mine, "__init__"}}
    return pairs


def test_every_package_has_its_level():
    named = {package for level in LEVELS for package in level}
    found = {package for pair in imports_between_packages() for package in pair}

    assert found - named - {"__init__"} == set()


def test_packages_import_only_packages_of_lower_levels():
    level_of = {name: number for number, level in enumerate(LEVELS) for name in level}

    upwards = {
        (one, other)
        for one, other in imports_between_packages()
        if level_of[one] >= level_of[other]
    }

    assert upwards == set()


def test_table_of_the_architecture_has_the_order_of_the_levels():
    level_of = {name: number for number, level in enumerate(LEVELS) for name in level}

    rows = names_in_rows(read("ARCHITECTURE.md"), "### app")
    names = [name.removesuffix("/").removesuffix(".py") for row in rows for name in row]

    assert sorted(names) == sorted(level_of.keys() - {"__main__"})
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


def test_opened_files_are_detected():
    program = "open(x)\npath.read_text()\ncv2.imread(x)\nread_text(x)\nImage.open(x)"

    assert opened_files(ast.parse(program)) == [1, 2, 3, 5]


def test_in_filter_core_only_formats_and_local_open_files():
    assert [
        f"{source.name}:{line}"
        for source in python_sources("filter_core")
        if not source.name.startswith(OPEN_FILES)
        for line in opened_files(source.tree)
    ] == []
