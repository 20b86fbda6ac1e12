"""Builds the wheel, and installs it into an environment apart from this checkout."""

import os
import re
import subprocess
import sys
import sysconfig
import venv
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path


@dataclass(frozen=True)
class Installation:
    """A Python with the wheel installed, and an empty folder to work in."""

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
        """The path of an installed console script."""
        return self.python.with_name(name)


def build_distributions(source: Path, *options: str, umask: int = -1) -> None:
    """Build in the folder `source`, as a release is built; into its folder `dist`."""
    subprocess.run(
        [
            *(sys.executable, "-m", "build"),
            *("--no-isolation", "--skip-dependency-check", *options),
        ],
        cwd=source,
        env={**os.environ, "SOURCE_DATE_EPOCH": "1790000000"},
        umask=umask,
        check=True,
        capture_output=True,
        text=True,
    )


def install(wheel: Path, folder: Path) -> Installation:
    """Install the wheel in a new environment that also sees this one's dependencies."""
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


def install_lowest(wheel: Path, folder: Path) -> Installation:
    """Install the wheel with the lowest versions of other packages that it allows.

    Of these, the newest release: ``numpy>=1.26`` is tried with 1.26.4.
    """
    home = folder / "venv"
    venv.create(home, with_pip=True, symlinks=True)
    python = home / "bin" / "python"
    lowest = [
        re.sub(r"([\w-]+)[^;]*>=([\d.]+)[^;]*", r"\1==\2.*", needed)
        for needed in metadata.requires("unghost") or []
        if "extra ==" not in needed
    ]
    pip = [str(python), "-m", "pip", "--quiet", "install", str(wheel), *lowest]
    subprocess.run(pip, check=True, capture_output=True, text=True)
    work = folder / "elsewhere"
    work.mkdir()
    return Installation(python, work)
