"""How many files and connections the process may have open at the same time."""

from __future__ import annotations

import sys
from typing import Final

_WANTED: Final = 65_536
_ALWAYS_ALLOWED: Final = 10_240
"""What macOS allows a process even where it says that there is no limit."""


def raise_descriptor_limit() -> int | None:
    """Raise the soft limit (RLIMIT_NOFILE) towards the hard one; what it is then.

    None where the system has no such limit: Windows. One that cannot be raised stays as
    it is.
    """
    if sys.platform == "win32":
        return None
    import resource  # only systems that have such limits have the module

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY:
        return None
    for wanted in (_WANTED, _ALWAYS_ALLOWED):
        most = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
        if most <= soft:
            break
        try:
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
        except (OSError, ValueError):
            continue
        return most
    return soft


def descriptor_limit() -> int | None:
    """The soft limit as it is; None where there is none."""
    if sys.platform == "win32":
        return None
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return None if soft == resource.RLIM_INFINITY else soft
