"""Makes sure that the test of what reaches the disk has strace, where apt gives it.

Elsewhere that test says that it is skipped; nothing else needs it.
"""

from __future__ import annotations

import shutil
import sys

from tools.ensure_chromium import as_root


def main() -> int:
    """Asks apt if there is none."""
    if shutil.which("strace") is None and shutil.which("apt-get"):
        as_root("apt-get", "update", "-q")
        as_root("apt-get", "install", "-qy", "--no-install-recommends", "strace")
    found = shutil.which("strace")
    print(f"system calls are traced by {found}" if found else "no strace: not traced")
    return 0


if __name__ == "__main__":
    sys.exit(main())
