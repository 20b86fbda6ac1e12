"""The wheel of this checkout, built once, and installed where nothing else of it is.

The dependencies come from the environment that runs the tests; the project itself
comes from the wheel and from nowhere else.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import sysconfig
import tempfile
import venv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[2]
NOT_SOURCE = shutil.ignore_patterns(
    ".git", ".venv", ".*_cache", "build", "dist", "*.egg-info", "node_modules", "*-data"
)


@dataclass(frozen=True)
class Installation:
    """A Python that has the wheel installed, and an empty folder to work in."""

    python: Path
    folder: Path

    def run(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Runs this Python, isolated, from the empty folder."""
        return subprocess.run(
            [self.python, "-I", *arguments],
            cwd=self.folder,
            capture_output=True,
            text=True,
            check=False,
            timeout=120,
        )

    def command(self, name: str) -> Path:
        """An installed console script."""
        return self.python.with_name(name)


@pytest.fixture(scope="session")
def distributions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sdist, and the wheel that was built from that sdist."""
    source = tmp_path_factory.mktemp("source") / "unghost"
    shutil.copytree(CHECKOUT, source, ignore=NOT_SOURCE)
    build = [sys.executable, "-m", "build", "--no-isolation", "."]
    subprocess.run(build, cwd=source, check=True, capture_output=True, text=True)
    return source / "dist"


@pytest.fixture(scope="session")
def wheel(distributions: Path) -> Path:
    """The wheel."""
    (found,) = distributions.glob("unghost-*.whl")
    return found


@pytest.fixture(scope="session")
def installation(wheel: Path) -> Iterator[Installation]:
    """The wheel in an environment of its own, far from the checkout."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # As an installation is: for every user of the machine to read.
        folder.chmod(0o755)
        yield install(wheel, folder)


def install(wheel: Path, folder: Path) -> Installation:
    """An environment with the wheel, and the dependencies of the one that runs this."""
    home = folder / "venv"
    venv.create(home, with_pip=False, symlinks=True)
    python = home / "bin" / "python"
    pip = [sys.executable, "-m", "pip", "--python", str(python), "--quiet"]
    install = [*pip, "install", "--no-deps", "--no-index", str(wheel)]
    subprocess.run(install, check=True, capture_output=True, text=True)
    (site_packages,) = home.glob("lib/python*/site-packages")
    dependencies = sysconfig.get_paths()["purelib"]
    (site_packages / "dependencies.pth").write_text(f"{dependencies}\n")
    work = folder / "elsewhere"
    work.mkdir()
    return Installation(python, work)
