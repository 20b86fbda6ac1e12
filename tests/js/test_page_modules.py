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
