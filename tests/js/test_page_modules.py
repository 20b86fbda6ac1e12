"""The page's own tests and types, run by node where it is installed."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

HERE = Path(__file__).parent
STATIC = HERE.parents[1] / "static"
NODE = shutil.which("node")
TSC = HERE / "node_modules" / ".bin" / "tsc"


def run(*command: str) -> str:
    done = subprocess.run(
        command, cwd=HERE, capture_output=True, text=True, timeout=200, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.skipif(NODE is None, reason="needs node 18 or newer")
@pytest.mark.parametrize("file", sorted((HERE / "unit").glob("*.test.js")), ids=str)
def test_pure_modules_keep_their_promises(file):
    run(str(NODE), "--test", str(file))


@pytest.mark.skipif(not TSC.exists(), reason="needs npm ci in tests/js")
def test_types_of_the_page_are_sound():
    run(str(TSC), "--project", "tsconfig.json")


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
