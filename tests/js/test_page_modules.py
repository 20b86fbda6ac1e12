"""Which folders the page's modules may import from, and how their tests are named."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.documents import names_in_rows, read
from tests.support.sources import CHECKOUT

STATIC = CHECKOUT / "static"
LEVELS = [
    ["."],
    ["shell"],
    ["queue", "grid"],
    ["review"],
    ["runs", "quality", "datasets"],
    ["tuning", "stage", "upload"],
    ["jobs"],
    ["boxes"],
    ["core"],
]
"""The folders of the page's modules, from the top down: a module may import from its
own folder and from those of the lines below."""
# The tests have no parser of JavaScript; imports are found by how they are written.
# Imports of types count too, since readers of one file need the other.
_IMPORTED = re.compile(r"""\b(?:from|import)\s*\(?\s*["'](\.[^"']+)["']""")


@pytest.mark.parametrize(
    "statement",
    [
        'import { one } from "../shell/shell.js";',
        "import { one,\n  two } from '../shell/shell.js';",
        'import "../shell/shell.js";',
        'export * from "../shell/shell.js";',
        'await import("../shell/shell.js");',
        '/** @typedef {import("../shell/shell.js").One} One */',
    ],
)
def test_every_form_of_an_import_is_detected(statement):
    assert _IMPORTED.findall(statement) == ["../shell/shell.js"]


def imports() -> Iterator[tuple[Path, Path]]:
    """(file, other): a module, and another one of the page that it imports."""
    for file in sorted(STATIC.glob("js/**/*.js")):
        for named in _IMPORTED.findall(file.read_text("utf-8")):
            other = (file.parent / named).resolve()
            if "vendor" not in other.parts:
                yield file, other


def test_modules_import_from_folders_below_their_own():
    level_of = {name: level for level, names in enumerate(LEVELS) for name in names}
    across = [
        [path.relative_to(STATIC / "js") for path in pair]
        for pair in imports()
        if pair[0].parent != pair[1].parent
    ]

    upwards = [
        f"{file} imports {other}"
        for file, other in across
        if level_of[str(other.parent)] <= level_of[str(file.parent)]
    ]

    assert len(across) > len(level_of)
    assert upwards == []


def test_table_of_the_architecture_has_the_order_of_the_levels():
    level_of = {name: level for level, names in enumerate(LEVELS) for name in names}

    rows = names_in_rows(read("ARCHITECTURE.md"), "## The review page")
    folders = [name.removesuffix("/") for row in rows for name in row]

    assert sorted(folders) == sorted(level_of.keys() - {"."})
    levels = [level_of[folder] for folder in folders]
    assert levels == sorted(levels)


def test_each_test_is_named_for_the_module_it_tests():
    tests = CHECKOUT / "tests" / "js"
    named = [
        file.relative_to(tests).as_posix().removesuffix(".test.js")
        for file in tests.glob("*/*.test.js")
    ]

    alone = [
        name
        for name in named
        # A file of types (.d.ts) counts as a module: those of the API have a test.
        if not any(
            (STATIC / "js" / f"{name}{end}").is_file() for end in (".js", ".d.ts")
        )
    ]

    assert named
    assert alone == []
