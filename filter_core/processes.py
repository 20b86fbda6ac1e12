"""Starts other Python processes, which search for modules where this one does.

By itself, Python searches for the modules of ``python -c`` and ``python -m`` first in
the folder in which it is started, and `multiprocessing` starts processes by ``-c``.
That folder may be somebody else's dataset, or one that everybody can write to, and a
file ``selectors.py`` in it would be run.
"""

from __future__ import annotations

import multiprocessing
import multiprocessing.util
import os
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from multiprocessing.context import ForkServerContext, SpawnContext

_start_as_given: Final = multiprocessing.util.spawnv_passfds
"""With this `multiprocessing` starts every program, except on Windows."""
_FORKING: Final = "forkserver"
_preloaded: Final[dict[str, None]] = {}


def module_command(module: str, *words: str) -> list[str]:
    """The command that runs a module, by its full name, as ``python -m`` does.

    The program and its arguments `words`, as `subprocess` takes them.
    """
    # Not ``-m``: before Python 3.11 it searches for `runpy` in the current folder.
    run = f"runpy.run_module({module!r}, run_name='__main__', alter_sys=True)"
    return _searching_here([sys.executable, "-c", f"import runpy; {run}", *words])


def child_context(preload: Sequence[str]) -> ForkServerContext | SpawnContext:
    """How `multiprocessing` starts processes: forked from a clean one, else spawned.

    `preload` are modules that are imported once for all processes, where the system can
    fork. Those of all calls before the first process is started are imported; later
    calls add nothing.
    """
    if _FORKING not in multiprocessing.get_all_start_methods():
        os.environ["PYTHONSAFEPATH"] = "1"  # Windows; Python 3.10 ignores it
        return multiprocessing.get_context("spawn")
    inside = vars(multiprocessing.util)
    inside["spawnv_passfds"] = _start
    # Up to Python 3.10.8, every user of the machine can talk to the process that forks
    # (CVE-2022-42919), unless its socket is a file.
    inside["abstract_sockets_supported"] = False
    context = multiprocessing.get_context(_FORKING)
    # `multiprocessing` has one such list for all contexts.
    _preloaded.update(dict.fromkeys(preload))
    context.set_forkserver_preload(list(_preloaded))
    return context


def _start(path: bytes, command: Sequence[str], descriptors: Sequence[int]) -> int:
    """Start a program for `multiprocessing`; its process id."""
    return _start_as_given(path, _searching_here(command), descriptors)


def _searching_here(command: Sequence[str]) -> list[str]:
    """The command of a program after ``-c``, made to search where this process does."""
    at = command.index("-c")
    # Python 3.13 imports a module before it runs the program's first line.
    flags = ["-P"] if sys.version_info >= (3, 11) else []
    program = f"import sys; sys.path[:] = {list(map(str, sys.path))!a}; "
    return [*command[:at], *flags, "-c", program + command[at + 1], *command[at + 2 :]]
