"""What the page's own code must not contain; tools/check_page.sh runs its tests."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

STATIC = Path(__file__).resolve().parents[2] / "static"


@pytest.mark.parametrize(
    ("pattern", "why"),
    [
        (r"style=\"|style='", "style attributes are forbidden by the policy"),
        (r"https?://(?!www\.w3\.org)", "nothing is loaded from elsewhere"),
    ],
)
def test_own_code_is_free_of(pattern, why):
    files = [*STATIC.glob("js/**/*.js"), *STATIC.glob("css/*.css")]
    found = [file.name for file in files if re.search(pattern, file.read_text())]

    assert found == [], why


def test_every_module_is_type_checked():
    unchecked = [
        file.name
        for file in STATIC.glob("js/**/*.js")
        if not file.read_text().startswith("// @ts-check\n")
    ]

    assert unchecked == []


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
"""The folders of the page's modules, from what is put together to what it is made of: a
module imports from its own folder and from those below."""
_IMPORTED = re.compile(r"""(?:from\s+|import\(\s*)"(\.[^"]+)\"""")


def test_modules_import_from_folders_below_their_own():
    level_of = {name: level for level, names in enumerate(LEVELS) for name in names}
    upwards = []
    for file in sorted(STATIC.glob("js/**/*.js")):
        own = file.parent.relative_to(STATIC / "js").as_posix()
        # Imports of types count too: who reads one file has to know the other.
        for named in _IMPORTED.findall(file.read_text()):
            other = (file.parent / named).resolve().parent
            if other == file.parent or "vendor" in other.parts:
                continue
            folder = other.relative_to(STATIC / "js").as_posix()
            if level_of[folder] <= level_of[own]:
                upwards.append(f"{own}/{file.name} imports {named}")

    assert upwards == []
