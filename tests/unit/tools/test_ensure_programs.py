"""Programs that the tests need are installed with apt if they are missing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.sources import CHECKOUT
from tools.ensure_programs import POSTGRESQL

# An apt-get that logs its arguments, and installs an empty program.
APT = """#!/bin/sh
echo "$@" >>"$0.log"
[ "$1" = install ] || exit 0
for package; do :; done
[ "$package" = nodejs ] && package=node
[ "$package" = postgresql ] && package=initdb
echo "#!/bin/sh" >"${0%/*}/$package"
/bin/chmod +x "${0%/*}/$package"
"""
SUDO = """#!/bin/sh
exec /usr/bin/"$@"
"""

PROGRAM_OF = {"nodejs": "node", "postgresql": "initdb"}
# PostgreSQL may be installed already, where Debian keeps it outside the PATH.
SERVER = [] if any(POSTGRESQL.glob("*/bin/initdb")) else ["postgresql"]


@pytest.fixture
def programs(tmp_path: Path) -> Path:
    """A folder with the only programs on the PATH: apt-get and (unless root) sudo."""
    for name, text in [("apt-get", APT), ("sudo", SUDO)]:
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    return tmp_path


def run_ensure_programs(programs: Path, **more: str) -> str:
    """Run the tool with only these programs on the PATH; returns what it prints."""
    environ = {key: value for key, value in os.environ.items() if key != "CI"}
    return subprocess.run(
        [sys.executable, "-m", "tools.ensure_programs"],
        cwd=CHECKOUT,
        env={**environ, "PATH": str(programs), **more},
        capture_output=True,
        text=True,
        check=True,
    ).stdout


def read_apt_calls(programs: Path) -> list[str]:
    log = programs / "apt-get.log"
    return log.read_text().splitlines() if log.exists() else []


@pytest.mark.parametrize(
    ("ci", "packages"),
    [
        pytest.param({}, ["strace"], id="a machine at hand"),
        pytest.param({"CI": "true"}, ["strace", "nodejs", "npm", *SERVER], id="CI"),
    ],
)
def test_missing_programs_are_installed(programs: Path, ci, packages):
    said = run_ensure_programs(programs, **ci)

    update, *installs = read_apt_calls(programs)
    assert update.startswith("update")
    assert [line.split()[-1] for line in installs] == packages
    for program in [PROGRAM_OF.get(name, name) for name in packages]:
        assert f"{program}: {programs / program}" in said


def test_installed_programs_are_not_installed_again(programs: Path):
    run_ensure_programs(programs, CI="true")
    asked = read_apt_calls(programs)

    run_ensure_programs(programs, CI="true")

    assert read_apt_calls(programs) == asked


def test_program_that_cannot_be_installed_is_reported(tmp_path: Path):
    assert "no strace" in run_ensure_programs(tmp_path)
