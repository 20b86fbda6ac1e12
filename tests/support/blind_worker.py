"""A worker of a cluster in whose place a folder is empty, as on another machine.

``python -m tests.support.blind_worker FOLDER`` mounts an empty folder there, which only
this process and those that it starts can see.
"""

import ctypes
import os
import sys

from unghost.cli import main

_NEW_NAMESPACE = 0x20000
_PRIVATE, _RECURSIVE = 1 << 18, 1 << 14


def hide(folder: str) -> None:
    """Mount an empty folder that no other process sees."""
    system = ctypes.CDLL(None, use_errno=True)
    for failed in (
        system.unshare(_NEW_NAMESPACE),
        system.mount(b"none", b"/", None, _PRIVATE | _RECURSIVE, None),
        system.mount(b"none", os.fsencode(folder), b"tmpfs", 0, None),
    ):
        if failed:
            raise OSError(ctypes.get_errno(), "cannot mount an empty folder")


if __name__ == "__main__":
    hide(sys.argv.pop())
    sys.argv.append("worker")
    sys.exit(main())
