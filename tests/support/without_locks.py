"""Runs a Python module as on a file system without locks, such as some NFS mounts.

``python without_locks.py ENOLCK MODULE WORDS`` does what ``python -m MODULE WORDS``
does, but every attempt to lock a file fails with that error.
"""

import errno
import fcntl
import os
import runpy
import sys
from typing import NoReturn

COMMAND = (sys.executable, __file__)


def fail_with(number: int) -> None:
    """Let every attempt of this process to lock a file fail with this error."""

    def flock(_file: object, _operation: int) -> NoReturn:
        raise OSError(number, os.strerror(number))

    fcntl.flock = flock


if __name__ == "__main__":
    fail_with(getattr(errno, sys.argv[1]))
    del sys.argv[:2]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
