"""Browser windows: how Chromium is started, sizes, and a person in front of one."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import pytest
from playwright.sync_api import (
    Browser,
    BrowserContext,
    Page,
    Route,
    StorageState,
    ViewportSize,
    expect,
    sync_playwright,
)

from tests.support.page.stage import after_drawing
from tests.support.servers import SESSION_KEY
from tools.ensure_chromium import system_chromium

ARGUMENTS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    # One process for all windows that show the server: each would start its own.
    "--process-per-site",
)
# What is between the narrow and the wide, and dark, is looked at by the long tests.
SCHEMES = ["light", pytest.param("dark", marks=pytest.mark.long)]
WIDTHS = [390, pytest.param(820, marks=pytest.mark.long), 1440]
WIDE = ViewportSize(width=1440, height=900)
PHONE = {"width": 390, "height": 844}
RE_VIEW = re.compile(r"\S+ \S+ \S+")
RE_SAVED = re.compile(r"savestate--saved")


@dataclass
class Visitor:
    """A person with a browser window, signed in."""

    page: Page
    url: str

    def open(self, link: str) -> Page:
        """Go somewhere and wait until it can be used."""
        self.page.goto(f"{self.url}/{link}")
        if link.startswith("#/frames/"):
            self.ready()
        return self.page

    def ready(self) -> None:
        """The stage has been drawn with its picture."""
        stage = self.page.locator(".stage")
        expect(stage).to_have_attribute("data-picture", "shown")
        expect(stage).to_have_attribute("data-view", RE_VIEW)
        after_drawing(self.page)

    def press(self, *keys: str) -> None:
        for key in keys:
            self.page.keyboard.press(key)

    def saved(self) -> None:
        """Every answer is on the server."""
        expect(self.page.locator(".savestate")).to_have_class(RE_SAVED)


Visit = Callable[..., Visitor]
RouteHandler = Callable[[Route], object]


def kept_session(page: Page) -> Any:
    """What the page has stored; None when nobody is signed in."""
    return page.evaluate("(key) => JSON.parse(localStorage.getItem(key))", SESSION_KEY)


def lose_session(page: Page) -> None:
    """From now on the server knows this window's session no more."""
    page.evaluate(
        """(key) => {
          const kept = JSON.parse(localStorage.getItem(key));
          localStorage.setItem(key, JSON.stringify({ ...kept, session: "us_ended" }));
          dispatchEvent(new StorageEvent("storage", { key }));
        }""",
        SESSION_KEY,
    )


# Answered by the server with 200, and by its route with 204.
IS_ROUTED = "/healthz?routed"
ASK_UNTIL_ROUTED = """async (address) => {
  while ((await fetch(address)).status !== 204);
}"""


def route_loaded(page: Page, url: str | re.Pattern[str], handler: RouteHandler) -> None:
    """Route what a document asks for that is loaded already, from now on.

    `page.route` returns before a loaded document knows of its first route: what a busy
    one asks for meanwhile goes past it. A document that is loaded later knows it from
    the start.
    """
    page.route(f"**{IS_ROUTED}", lambda route: route.fulfill(status=204))
    page.route(url, handler)
    page.evaluate(ASK_UNTIL_ROUTED, IS_ROUTED)
    page.unroute(f"**{IS_ROUTED}")


FILL = """() => {
  const { setItem } = Storage.prototype;
  Storage.prototype.setItem = function (name, value) {
    const isMore = value.length > (this.getItem(name) ?? "").length;
    if (isMore) throw new DOMException("it is full", "QuotaExceededError");
    setItem.call(this, name, value);
  };
}"""
"""From now on this window's browser has no room for more."""


# The page keeps nothing elsewhere in the browser.
KEEP_ONLY = """(items) => {
  localStorage.clear();
  for (const { name, value } of items) localStorage.setItem(name, value);
}"""
OPTIONS: dict[str, Any] = {"viewport": WIDE, "reduced_motion": "reduce"}


@dataclass(frozen=True)
class Plain:
    """The window of whoever asks for nothing special; a new page each time."""

    context: BrowserContext
    kept: Page
    """Stays open, without a script: a window that loses its last page is no quicker."""

    def page(self, state: StorageState) -> Page:
        """A page of somebody who is signed in and has been nowhere yet."""
        (origin,) = state["origins"]
        self.context.clear_cookies()
        self.kept.evaluate(KEEP_ONLY, origin["localStorage"])
        return self.context.new_page()

    def leave(self) -> None:
        """Take away what a test has left; each page takes its own things with it."""
        self.context.set_offline(False)
        self.context.unroute_all()
        for page in self.context.pages:
            if page is not self.kept:
                page.close()


@contextmanager
def launched() -> Iterator[Browser]:
    """Chromium of the system, or Playwright's own."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=system_chromium(), args=list(ARGUMENTS)
        )
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def new_context(browser: Browser, **options: Any) -> Iterator[BrowserContext]:
    """A window of a size, a colour scheme, a person of its own."""
    context = browser.new_context(**{**OPTIONS, **options})
    context.set_default_timeout(15_000)
    yield context
    context.close()
