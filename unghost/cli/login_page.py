"""A login link handed to the browser by a file that only its owner can read.

The arguments of a browser are seen by everybody on the machine. It is given the name
of the file; the link, and the code in it, are inside. `unghost login` and `unghost
serve` share it.
"""

from __future__ import annotations

import os
import tempfile
import threading
import webbrowser
from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Final

_LOOK_EVERY_S: Final = 1.0
_PREFIX: Final = "login-"
_SUFFIX: Final = ".html"
_PAGE: Final = """<!doctype html>
<meta charset="utf-8">
<meta name="referrer" content="no-referrer">
<meta http-equiv="refresh" content="0; url={link}">
<title>Unghost</title>
<p><a href="{link}">Open Unghost</a></p>
"""


class LoginPage:
    """One file, there as long as the code in it lets somebody in."""

    def __init__(self, link: str, folder: Path) -> None:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        # mkstemp makes it for its owner alone, under a name that nobody else has.
        descriptor, name = tempfile.mkstemp(_SUFFIX, _PREFIX, folder)
        self.file = Path(name)
        with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
            stream.write(_PAGE.format(link=escape(link)))

    def show(self) -> bool:
        """Open it in the browser; False if there is none."""
        return webbrowser.open(self.file.resolve().as_uri())

    def remove(self) -> None:
        """Take the file away."""
        self.file.unlink(missing_ok=True)

    def remove_when(self, is_over: Callable[[], bool], stop: threading.Event) -> None:
        """Take the file away once the code is used or has ended, or at a stop."""
        try:
            while not stop.is_set() and not is_over():
                stop.wait(_LOOK_EVERY_S)
        finally:
            self.remove()


def remove_left_over(folder: Path) -> None:
    """Take away the files of a service that was ended before it could."""
    for file in folder.glob(f"{_PREFIX}*{_SUFFIX}"):
        file.unlink(missing_ok=True)
