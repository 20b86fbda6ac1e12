"""The page in a real browser against the real server, with data sent over HTTP."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any, cast

import httpx
import pytest
from playwright.sync_api import (
    Browser,
    BrowserContext,
    Page,
    StorageState,
    ViewportSize,
    expect,
    sync_playwright,
)

from tests.browser import scenes
from tests.browser.stage import after_drawing
from tests.support.servers import SESSION_KEY, RunningServer

CHROMIUM = Path("/usr/bin/chromium")
ARGUMENTS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)
# Busy machines are slow, not wrong; what is right is seen at once all the same.
expect.set_options(timeout=15_000)

# What is between the narrow and the wide, and dark, is looked at by the long tests.
SCHEMES = ["light", pytest.param("dark", marks=pytest.mark.long)]
WIDTHS = [390, pytest.param(820, marks=pytest.mark.long), 1440]
WIDE = ViewportSize(width=1440, height=900)
PHONE = {"width": 390, "height": 844}

RE_VIEW = re.compile(r"\S+ \S+ \S+")
RE_SAVED = re.compile(r"savestate--saved")

_numbers = count(1)


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """Chromium of the system, or the one that Playwright has installed."""
    path = str(CHROMIUM) if CHROMIUM.exists() else None
    with sync_playwright() as playwright:
        launched = playwright.chromium.launch(
            executable_path=path, args=list(ARGUMENTS)
        )
        yield launched
        launched.close()


@pytest.fixture(scope="session")
def api(server: RunningServer) -> Iterator[httpx.Client]:
    """The server as a program sees it."""
    base = f"{server.url}/api/v1"
    with httpx.Client(base_url=base, headers=server.headers, timeout=60) as client:
        yield client


@dataclass(frozen=True)
class Scene:
    """A dataset of the test's own and its first frame."""

    api: httpx.Client
    dataset: str
    frame: dict[str, Any]

    def box_id(self, name: str) -> int:
        """The server's id of the box that the sender called so."""
        found: int = self._box(name)["box_id"]
        return found

    def review(self, name: str) -> Any:
        """What the server has stored as the latest answer; None without one."""
        return scenes.get(self.api, f"/boxes/{self.box_id(name)}")["review"]

    def revision(self, name: str) -> int:
        box = scenes.get(self.api, f"/boxes/{self.box_id(name)}")
        revision: int = box["revision"]
        return revision

    def link(self, name: str = "", **query: str) -> str:
        """The address of the frame with a box selected."""
        wanted = {**({"box": str(self.box_id(name))} if name else {}), **query}
        search = "&".join(f"{key}={value}" for key, value in wanted.items())
        return f"#/frames/{self.frame['id']}{'?' if search else ''}{search}"

    def decide(self, **config: object) -> None:
        """Make a configuration the one that decides, and wait until it does."""
        scenes.decide(self.api, self.dataset, config)

    def push(self, key: str, **kwargs: Any) -> dict[str, Any]:
        """One more frame."""
        return scenes.push(self.api, self.dataset, key, **kwargs)

    def _box(self, name: str) -> dict[str, Any]:
        return next(box for box in self.frame["boxes"] if box["id"] == name)


MakeScene = Callable[..., Scene]


@pytest.fixture
def make_scene(api: httpx.Client) -> MakeScene:
    """`make_scene(form="raw", boxes=[...])`: a new dataset with one frame."""

    def make(form: str = "palette", boxes: list[dict[str, Any]] | None = None) -> Scene:
        dataset = f"scene-{next(_numbers)}"
        made = api.post("/datasets", json={"name": dataset, "palette": scenes.FAMILY})
        assert made.status_code == 201, made.text
        frame = scenes.push(api, dataset, "run/000001", boxes, form)
        return Scene(api, dataset, frame)

    return make


@pytest.fixture
def scene(make_scene: MakeScene) -> Scene:
    return make_scene()


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


@pytest.fixture(scope="session")
def signed_in(server: RunningServer) -> StorageState:
    """What signing in leaves in a browser; the sign-in itself has its own tests."""
    return cast("StorageState", server.signed_in())


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


@pytest.fixture(scope="session")
def plain(browser: Browser, server: RunningServer) -> Iterator[Plain]:
    """One window for all tests: making another takes as long as a page does."""
    with new_context(browser) as context:
        kept = context.new_page()
        kept.goto(f"{server.url}/healthz")
        yield Plain(context, kept)


@contextmanager
def new_context(browser: Browser, **options: Any) -> Iterator[BrowserContext]:
    """A window of a size, a colour scheme, a person of its own."""
    context = browser.new_context(**{**OPTIONS, **options})
    context.set_default_timeout(15_000)
    yield context
    context.close()


@pytest.fixture
def visit(
    browser: Browser, server: RunningServer, signed_in: StorageState, plain: Plain
) -> Iterator[Visit]:
    """Opens a window: `visit(color_scheme="dark")`. No script may fail in it.

    The first that asks for nothing gets the one of all tests, emptied.
    """
    faults: list[str] = []
    taken = False

    def arrive(*, sign_in: bool = True, **options: Any) -> Visitor:
        nonlocal taken
        if taken or options or not sign_in:
            state = signed_in if sign_in else None
            own = new_context(browser, storage_state=state, **options)
            page = opened.enter_context(own).new_page()
        else:
            taken = True
            opened.callback(plain.leave)
            page = plain.page(signed_in)
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("console", lambda message: note(message.type, message.text))
        return Visitor(page, server.url)

    def note(kind: str, text: str) -> None:
        # A refused request is part of some tests; a broken policy never is.
        if kind == "error" and not text.startswith("Failed to load resource"):
            faults.append(text)

    with ExitStack() as opened:
        yield arrive
    assert faults == []


@pytest.fixture
def ada(visit: Visit) -> Visitor:
    return visit()
