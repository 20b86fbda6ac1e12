"""Installs with apt the programs that tests and checks call, where they are missing.

strace is for the test of what reaches the disk. Node and npm are for the checks of the
page's JavaScript, PostgreSQL's initdb for the tests on a PostgreSQL server. These three
are large, or start a service, so they are installed only where no check and no test
may be left out: where the variable CI is set.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

PACKAGE_OF = {
    "strace": "strace",
    "node": "nodejs",
    "npm": "npm",
    "initdb": "postgresql",
}
# Debian puts a server's programs here, by version, and not on the PATH.
POSTGRESQL = Path("/usr/lib/postgresql")


def path_of(program: str) -> str | None:
    """Where a program is; None where it is not installed."""
    servers = sorted(POSTGRESQL.glob("*/bin"), reverse=True)
    beside = os.pathsep.join(str(folder) for folder in servers)
    return shutil.which(program) or shutil.which(program, path=beside)


def run(*command: str) -> None:
    """Runs without a terminal; who calls looks whether it did what it should."""
    print("+", " ".join(command), flush=True)
    quiet = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    subprocess.run(command, check=False, stdin=subprocess.DEVNULL, env=quiet)


def as_root(*command: str) -> None:
    """Runs with sudo unless already root; without either there is nothing to try."""
    if os.geteuid() == 0:
        run(*command)
    elif shutil.which("sudo"):
        run("sudo", "env", "DEBIAN_FRONTEND=noninteractive", *command)


def from_apt(*packages: str) -> None:
    """Installs the packages that the distribution has; none where there is no apt."""
    if os.name == "nt" or not shutil.which("apt-get"):
        return
    as_root("apt-get", "update", "-q")
    for package in packages:
        as_root("apt-get", "install", "-qy", "--no-install-recommends", package)


def main() -> int:
    """Installs what is missing, and says what was found in the end."""
    wanted = [*PACKAGE_OF] if os.environ.get("CI") else ["strace"]
    missing = [name for name in wanted if path_of(name) is None]
    if missing:
        from_apt(*(PACKAGE_OF[name] for name in missing))
    for name in wanted:
        found = path_of(name)
        print(f"{name}: {found}" if found else f"no {name}: what needs it is left out")
    return 0


if __name__ == "__main__":
    sys.exit(main())
