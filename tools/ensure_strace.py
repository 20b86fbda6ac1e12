"""Installs strace with apt, if it is missing, for the test of what reaches the disk.

Where apt does not have it, that test is skipped; nothing else needs it.
"""

from __future__ import annotations

import shutil
import sys

from tools.ensure_chromium import as_root


def main() -> int:
    """Install strace if there is none."""
    if shutil.which("strace") is None and shutil.which("apt-get"):
        as_root("apt-get", "update", "-q")
        as_root("apt-get", "install", "-qy", "--no-install-recommends", "strace")
    found = shutil.which("strace")
    print(f"strace: {found}" if found else "no strace: the test of writes is skipped")
    return 0


if __name__ == "__main__":
    sys.exit(main())
