"""Starts Chromium, opens windows of several sizes, and acts as a user of the page."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

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
from playwright.sync_api import TimeoutError as PlaywrightTimeout

from tests.support.page.stage import wait_for_drawing
from tests.support.servers import SESSION_KEY
from tests.support.waiting import until
from tools.ensure_chromium import system_chromium

ARGUMENTS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    # One process for all windows of the server: otherwise each starts its own.
    "--process-per-site",
)
WIDTHS = (390, 820, 1440)
WIDE = ViewportSize(width=1440, height=900)
PHONE = ViewportSize(width=390, height=844)
OVERFLOW = "document.documentElement.scrollWidth - innerWidth"
"""How many pixels the document is wider than its window: at most 0 if it fits."""
RE_VIEW = re.compile(r"\S+ \S+ \S+")
RE_SAVED = re.compile(r"savestate--saved")


@dataclass
class Visitor:
    """A user who is signed in, with a page in a browser window."""

    page: Page
    url: str

    def open(self, link: str) -> Page:
        """Go to a view of the page; a frame's view is waited for until it is drawn."""
        self.page.goto(f"{self.url}/{link}")
        if link.startswith("#/frames/"):
            self.wait_until_drawn()
        return self.page

    def wait_until_drawn(self) -> None:
        """Wait until the stage has drawn its picture."""
        stage = self.page.locator(".stage")
        expect(stage).to_have_attribute("data-picture", "shown")
        expect(stage).to_have_attribute("data-view", RE_VIEW)
        wait_for_drawing(self.page)

    def press(self, *keys: str) -> None:
        """Press keys as somebody who looks first: once the current box was painted."""
        for key in keys:
            self.wait_until_painted()
            self.page.keyboard.press(key)

    def wait_until_painted(self) -> None:
        """Wait until the current box was painted, or its picture does not come."""
        with suppress(PlaywrightTimeout):
            self.page.wait_for_function(IS_PAINTED, timeout=2000)

    def send_now(self) -> None:
        """Let the page send what waits, without a button that goes once it is sent."""
        self.page.evaluate("dispatchEvent(new Event('online'))")

    def wait_until_saved(self) -> None:
        """Wait until the page shows that every answer is saved on the server."""
        expect(self.page.locator(".savestate")).to_have_class(RE_SAVED)


OpenWindow = Callable[..., Visitor]
RouteHandler = Callable[[Route], object]


def kept_session(page: Page) -> Any:
    """The session that the page has stored in the browser; None if signed out."""
    return page.evaluate("(key) => JSON.parse(localStorage.getItem(key))", SESSION_KEY)


def lose_session(page: Page) -> None:
    """Replace this window's stored session by one that the server does not know."""
    page.evaluate(
        """(key) => {
          const kept = JSON.parse(localStorage.getItem(key));
          localStorage.setItem(key, JSON.stringify({ ...kept, session: "us_ended" }));
          dispatchEvent(new StorageEvent("storage", { key }));
        }""",
        SESSION_KEY,
    )


# The server answers this with 200, its route with 204.
IS_ROUTED = "/healthz?routed"
ASK_UNTIL_ROUTED = """async (address) => {
  while ((await fetch(address)).status !== 204);
}"""


def route_loaded(page: Page, url: str | re.Pattern[str], handler: RouteHandler) -> None:
    """Route requests of a document that is already loaded.

    `page.route` returns before a loaded document knows of its first route, so requests
    of a busy document would go past it for a while. This waits until one is routed.
    Documents that are loaded later know their routes from the start.
    """
    page.route(f"**{IS_ROUTED}", lambda route: route.fulfill(status=204))
    page.route(url, handler)
    page.evaluate(ASK_UNTIL_ROUTED, IS_ROUTED)
    page.unroute(f"**{IS_ROUTED}")


def first_held(page: Page, held: list[Route]) -> Route:
    """Wait until a handler of the page has put a request into `held`, and return it.

    What the page shows while it waits for an answer can be seen before the handler of
    the request is called.
    """
    return until(lambda: page.evaluate("true") and held, "no request is held")[0]


IS_PAINTED = """() => {
  const stage = document.querySelector(".stage");
  if (!stage || !stage.dataset.box || stage.dataset.picture === "failed") return true;
  return stage.dataset.painted === stage.dataset.box;
}"""

LOSE_A_REQUEST = """async () => {
  while (await fetch("/healthz").then(() => true, () => false));
}"""


def go_offline(page: Page) -> None:
    """Take the window offline, and wait until no request reaches the server."""
    page.context.set_offline(True)
    page.wait_for_function("!navigator.onLine")
    page.evaluate(LOSE_A_REQUEST)


def hold_timers(page: Page, least_ms: int) -> None:
    """Let no timer of this many milliseconds or more end.

    A slow machine may otherwise let the page remove a message, or send a request again,
    before the test acts.
    """
    script = f"""(() => {{
      const start = window.setTimeout.bind(window);
      window.setTimeout = (run, ms) => (ms >= {least_ms} ? 0 : start(run, ms));
    }})()"""
    page.add_init_script(script)
    page.evaluate(script)


FILL = """() => {
  const { setItem } = Storage.prototype;
  Storage.prototype.setItem = function (name, value) {
    const isMore = value.length > (this.getItem(name) ?? "").length;
    if (isMore) throw new DOMException("it is full", "QuotaExceededError");
    setItem.call(this, name, value);
  };
}"""
"""Let the browser's storage refuse, from now on, all values that need more room."""


# Local storage is the only place in the browser where the page stores something.
KEEP_ONLY = """(items) => {
  localStorage.clear();
  for (const { name, value } of items) localStorage.setItem(name, value);
}"""
OPTIONS: dict[str, Any] = {"viewport": WIDE, "reduced_motion": "reduce"}


@dataclass(frozen=True)
class SharedWindow:
    """The window of tests without special wishes; each test gets a new page in it."""

    context: BrowserContext
    kept: Page
    """Stays open: a window that lost its last page is slow to open another."""

    def page(self, state: StorageState, *, viewport: ViewportSize = WIDE) -> Page:
        """A new page of the server, signed in with this stored state.

        The page that stays open opens it, so that no process has to start: an empty
        page would be in a process of its own until it is led to the server.
        """
        (origin,) = state["origins"]
        self.context.clear_cookies()
        self.kept.evaluate(KEEP_ONLY, origin["localStorage"])
        with self.context.expect_page() as opened:
            self.kept.evaluate("void open(location.href, '_blank', 'noopener')")
        page = opened.value
        if viewport != WIDE:
            page.set_viewport_size(viewport)
        return page

    def leave(self) -> None:
        """Undo what a test changed in the window, and close its pages."""
        self.context.set_offline(False)
        self.context.unroute_all()
        for page in self.context.pages:
            if page is not self.kept:
                page.close()


@contextmanager
def launched() -> Iterator[Browser]:
    """Start Chromium: the system's, or else Playwright's own."""
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
    """Open a window with its own storage; `options` are those of Playwright."""
    context = browser.new_context(**{**OPTIONS, **options})
    context.set_default_timeout(15_000)
    yield context
    context.close()
