"""Fixtures of the browser tests: a browser, a real server, and data sent over HTTP."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import count
from typing import Any, NamedTuple, cast

import httpx
import pytest
from playwright.sync_api import Browser, StorageState, expect

from tests.support import plain_http
from tests.support.api import BY_TAGS
from tests.support.page import scenes
from tests.support.page.scenes import MakeScene, Scene
from tests.support.page.tuning import car_at
from tests.support.page.windows import (
    OpenWindow,
    SharedWindow,
    Visitor,
    launched,
    new_context,
)
from tests.support.servers import RunningServer, running_server

# Long enough for a busy machine; an expectation that holds ends the wait at once.
expect.set_options(timeout=15_000)


_numbers = count(1)
MODULES_OF_A_SITE = 8


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """One browser for all tests."""
    with launched() as running:
        yield running


class Site(NamedTuple):
    """A server, and a window of it that tests share, since opening one takes long."""

    server: RunningServer
    window: SharedWindow


@pytest.fixture(scope="session")
def next_site(
    browser: Browser, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[[], Site]]:
    """Gives each module a site, which some modules before and after it have, too.

    Not all do: the page takes long to list hundreds of datasets.
    """
    sites: list[Site] = []
    modules = count()

    def give() -> Site:
        if next(modules) % MODULES_OF_A_SITE == 0:
            opened.close()
            data = tmp_path_factory.mktemp("server") / "data"
            server = opened.enter_context(running_server(data))
            context = opened.enter_context(new_context(browser))
            kept = context.new_page()
            kept.goto(f"{server.url}/healthz")
            sites.append(Site(server, SharedWindow(context, kept)))
        return sites[-1]

    with ExitStack() as opened:
        yield give


@pytest.fixture(scope="module")
def site(next_site: Callable[[], Site]) -> Site:
    return next_site()


@pytest.fixture(scope="module")
def server(site: Site) -> RunningServer:
    return site.server


@pytest.fixture(scope="module")
def http(server: RunningServer) -> Iterator[httpx.Client]:
    """An HTTP client of the server's API, with the rights of an admin."""
    base = f"{server.url}/api/v1"
    with plain_http.Client(base_url=base, headers=server.headers, timeout=60) as client:
        yield client


@pytest.fixture(scope="module")
def make_scene(http: httpx.Client) -> MakeScene:
    """Makes a new dataset with one frame: `make_scene(form="raw", boxes=[...])`.

    By default it is decided by tags, as in the paper.
    """

    def make(
        form: str = "palette",
        boxes: list[dict[str, Any]] | None = None,
        config: dict[str, str] | None = None,
    ) -> Scene:
        dataset = f"scene-{next(_numbers)}"
        by_tags = {"palette": scenes.FAMILY, "config": config or BY_TAGS}
        made = http.post("/datasets", json={"name": dataset, **by_tags})
        assert made.status_code == 201, made.text
        frame = scenes.push(http, dataset, "run/000001", boxes, form)
        return Scene(http, dataset, frame)

    return make


@pytest.fixture
def scene(make_scene: MakeScene) -> Scene:
    return make_scene()


@pytest.fixture
def street(make_scene: MakeScene) -> Scene:
    """A dataset with one frame of two cars, of 30 and 55 percent."""
    return make_scene(boxes=[car_at(30, 0), car_at(55, 1)])


@pytest.fixture(scope="module")
def signed_in(server: RunningServer) -> StorageState:
    """What the browser stores for somebody who is signed in as an admin."""
    return cast("StorageState", server.signed_in())


@pytest.fixture
def open_window(
    browser: Browser,
    server: RunningServer,
    signed_in: StorageState,
    site: Site,
) -> Iterator[OpenWindow]:
    """Opens a window: `open_window(viewport=PHONE)`.

    The first call of a test gets the shared window, emptied, unless it asks for one of
    its own (`own=True`) or for more than a size. The test fails at its end if a script
    failed in any of its windows.
    """
    faults: list[str] = []
    taken = False

    def arrive(*, sign_in: bool = True, own: bool = False, **options: Any) -> Visitor:
        nonlocal taken
        if taken or own or not sign_in or options.keys() - {"viewport"}:
            state = signed_in if sign_in else None
            window = new_context(browser, storage_state=state, **options)
            page = opened.enter_context(window).new_page()
        else:
            taken = True
            opened.callback(site.window.leave)
            page = site.window.page(signed_in, **options)
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("console", lambda message: note(message.type, message.text))
        return Visitor(page, server.url)

    def note(kind: str, text: str) -> None:
        # Requests may fail: some tests want that. Other errors, such as a violation of
        # the content security policy, are faults.
        if kind == "error" and not text.startswith("Failed to load resource"):
            faults.append(text)

    with ExitStack() as opened:
        yield arrive
    assert faults == []


@pytest.fixture
def user(open_window: OpenWindow) -> Visitor:
    return open_window()
