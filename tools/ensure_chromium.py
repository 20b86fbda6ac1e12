"""Makes sure that the browser tests have a Chromium that starts.

An installed one is used: the system's Chromium, or Playwright's. Otherwise Playwright
downloads its build; where that download is out of reach, apt is asked. The headless
shell is preferred, also by Playwright: the same engine without a browser's windows,
which takes a quarter less time.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from playwright.sync_api import Error, sync_playwright

from tools import ensure_programs
from tools.ensure_programs import run

SYSTEM_CHROMIUMS = ("/usr/bin/chromium-headless-shell", "/usr/bin/chromium")


def system_chromium() -> str | None:
    """The path of the system's Chromium; None where there is none."""
    return next((path for path in SYSTEM_CHROMIUMS if Path(path).exists()), None)


def starts(executable: str | None) -> bool:
    """True when Chromium opens a page; None stands for Playwright's own build."""
    sandbox = [] if os.name == "nt" or os.geteuid() else ["--no-sandbox"]
    with sync_playwright() as playwright:
        try:
            browser = playwright.chromium.launch(
                executable_path=executable, args=sandbox
            )
        except Error:
            return False
        browser.new_page().close()
        browser.close()
    return True


def found() -> str:
    """Which Chromium works: its path, "Playwright's own", or nothing.

    In the order in which the browser tests choose.
    """
    executable = system_chromium()
    if not starts(executable):
        return ""
    return executable or "Playwright's own"


def from_apt() -> None:
    """The distribution's own package."""
    for package in ("chromium-headless-shell", "chromium"):
        ensure_programs.from_apt(package)
        if system_chromium():
            return


def main() -> int:
    """Tries one source after the other and says which browser will be used."""
    install = [sys.executable, "-m", "playwright", "install"]
    attempts: list[Callable[[], None]] = [
        partial(run, *install, "chromium"),  # without the system's libraries
        from_apt,
        partial(run, *install, "--with-deps", "chromium"),  # asks for sudo if needed
    ]
    browser = found()
    while not browser and attempts:
        attempts.pop(0)()
        browser = found()
    if not browser:
        print("No Chromium could be installed; install one and run make again.")
        return 1
    print(f"browser tests use {browser}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
