"""Without Node the checks of the page are skipped locally, but fail in CI."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.support.sources import CHECKOUT


@pytest.mark.parametrize(
    ("ci", "status", "said"),
    [
        pytest.param({}, 0, "were not checked here", id="a machine at hand"),
        pytest.param({"CI": "true"}, 1, "no check is left out", id="CI"),
    ],
)
def test_check_page_without_node_is_skipped_locally_but_fails_in_ci(
    tmp_path: Path, ci: dict[str, str], status, said
):
    shell = shutil.which("sh")
    assert shell

    done = subprocess.run(
        [shell, CHECKOUT / "tools" / "check_page.sh"],
        env={"PATH": str(tmp_path), **ci},
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.returncode == status
    assert done.stdout.startswith("Node is not installed")
    assert said in done.stdout
    assert done.stderr == ""
