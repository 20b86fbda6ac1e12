"""Which folders the page's modules may import from, and how their tests are named."""

from __future__ import annotations

import re

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
_IMPORTED = re.compile(r"""(?:from\s+|import\(\s*)"(\.[^"]+)\"""")


def test_modules_import_from_folders_below_their_own():
    level_of = {name: level for level, names in enumerate(LEVELS) for name in names}
    upwards = []
    for file in sorted(STATIC.glob("js/**/*.js")):
        own = file.parent.relative_to(STATIC / "js").as_posix()
        # Imports of types count too, since readers of one file need the other.
        for named in _IMPORTED.findall(file.read_text()):
            other = (file.parent / named).resolve().parent
            if other == file.parent or "vendor" in other.parts:
                continue
            folder = other.relative_to(STATIC / "js").as_posix()
            if level_of[folder] <= level_of[own]:
                upwards.append(f"{own}/{file.name} imports {named}")

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
