"""Installs with apt the programs that tests and checks call, where they are missing.

strace is for the test of what reaches the disk. Node and npm are for the checks of the
page's JavaScript. Debian's npm brings some hundred packages with it, so they are
installed only where no check may be left out: where the variable CI is set.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

PACKAGE_OF = {"strace": "strace", "node": "nodejs", "npm": "npm"}


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
    wanted = ["strace", "node", "npm"] if os.environ.get("CI") else ["strace"]
    missing = [name for name in wanted if shutil.which(name) is None]
    if missing:
        from_apt(*(PACKAGE_OF[name] for name in missing))
    for name in wanted:
        found = shutil.which(name)
        print(f"{name}: {found}" if found else f"no {name}: what needs it is left out")
    return 0


if __name__ == "__main__":
    sys.exit(main())
