"""People who share a browser or a machine do not answer under each other's name."""

import json

import pytest
from playwright.sync_api import Error, expect

from tests.support import plain_http
from tests.support.page.windows import first_held, kept_session
from tests.support.waiting import until

pytestmark = pytest.mark.browser


@pytest.fixture
def bo(server, http):
    """The name and the token of another person than the admin."""
    name = f"bo-{len(http.get('/tokens').json()['items'])}"
    token = http.post("/tokens", json={"name": name}).json()["token"]
    return name, token


def test_foreign_login_link_does_not_replace_the_current_session(
    open_window, server, bo
):
    name, token = bo
    page = open_window().open("#/datasets")
    expect(page.locator(".who__name")).to_have_text("admin")
    before = kept_session(page)

    page.goto(server.login_link_of(token))

    question = page.get_by_role("dialog")
    expect(question).to_contain_text(f"Sign in as {name} instead of admin?")
    assert page.url == f"{server.url}/#/datasets"
    assert kept_session(page) == before
    question.get_by_role("button", name="Stay admin").click()
    expect(question).to_be_hidden()
    page.reload()
    expect(page.locator(".who__name")).to_have_text("admin")
    assert kept_session(page)["session"] == before["session"]

    page.goto(server.login_link_of(token))
    expect(page.get_by_role("button", name="Stay admin")).to_be_focused()

    with page.expect_response(lambda sent: sent.request.method == "DELETE") as ended:
        page.keyboard.press("Escape")

    assert ended.value.url == f"{server.url}/api/v1/session"
    expect(page.get_by_role("dialog")).to_have_count(0)
    expect(page.locator(".who__name")).to_have_text("admin")


def test_signing_in_as_another_person_switches_every_tab(open_window, server, bo):
    name, token = bo
    page = open_window(sign_in=False).page
    ends = []  # the request that ends the former session, held while the page reloads
    page.route(
        "**/api/v1/session",
        lambda route: (
            ends.append(route)
            if route.request.method == "DELETE"
            else route.continue_()
        ),
    )
    page.goto(server.login_link)
    expect(page.locator(".who__name")).to_have_text("admin")
    other = page.context.new_page()
    other.goto(f"{server.url}/#/datasets")
    expect(other.locator(".who__name")).to_have_text("admin")
    before = kept_session(page)["session"]

    page.goto(server.login_link_of(token))
    page.get_by_role("button", name=f"Sign in as {name}").click()

    expect(page.locator(".who__name")).to_have_text(name)
    expect(other.locator(".who__name")).to_have_text(name)
    shown = {"Authorization": f"Bearer {before}"}
    first_held(page, ends).continue_()
    version = f"{server.url}/version"
    until(lambda: plain_http.get(version, headers=shown).status_code == 401)


def test_unsent_answer_is_never_sent_as_another_person(open_window, server, bo, scene):
    """It stays in the browser until the person who gave it signs in again."""
    name, token = bo
    ada = open_window(sign_in=False)
    page = ada.page
    # Set before the page is opened: a page that is loaded may not use a new route.
    page.route("**/reviews", lambda route: route.abort())
    page.goto(server.login_link)
    expect(page.locator(".who__name")).to_have_text("admin")
    ada.open(scene.link("ghost"))
    ada.press("a")
    expect(page.locator(".savestate")).to_contain_text("1 answer waiting: offline")

    page.goto(server.login_link_of(token))
    page.get_by_role("button", name=f"Sign in as {name}").click()
    expect(page.locator(".who__name")).to_have_text(name)
    page.unroute("**/reviews")
    ada.open(scene.link("real"))
    ada.press("x")
    ada.wait_until_saved()
    assert scene.review("real")["reviewer"] == name
    assert scene.review("ghost") is None

    page.get_by_role("button", name="Settings").click()
    page.get_by_role("button", name="Sign out").click()
    expect(page.locator(".signin__note")).to_contain_text("1 answer of admin kept")
    page.goto(server.login_link)
    expect(page.locator(".who__name")).to_have_text("admin")
    ada.wait_until_saved()
    until(lambda: scene.review("ghost") is not None)
    assert scene.review("ghost")["reviewer"] == "admin"


def test_server_on_another_port_receives_no_session_and_no_cookie(
    open_window, server, start_server
):
    """Servers on several ports of a machine share cookies, but not `localStorage`.

    The session is kept there, so the other server never receives it.
    """
    user = open_window(sign_in=False)
    page = user.page
    page.goto(server.login_link)
    expect(page.locator("[data-view=datasets]")).to_be_visible()
    secret = kept_session(page)["session"]
    other = start_server()
    shown: list[tuple[str, dict[str, str]]] = []
    page.context.on(
        "request", lambda request: shown.append((request.url, request.all_headers()))
    )

    theirs = page.context.new_page()
    theirs.goto(other.login_link)
    expect(theirs.locator("[data-view=datasets]")).to_be_visible()
    stored = theirs.evaluate("JSON.stringify({...localStorage}) + document.cookie")
    with pytest.raises(Error, match="fetch"):
        theirs.evaluate("(url) => fetch(url)", f"{server.url}/api/v1/session")

    sent = [headers for url, headers in shown if url.startswith(other.url)]
    assert sent
    assert secret not in json.dumps(sent)
    assert not any("cookie" in headers for headers in sent)
    assert secret not in stored
    assert page.context.cookies() == []
    # Signing in on the other server has not ended the session on this one.
    page.reload()
    expect(page.locator(".who__name")).to_have_text("admin")
    assert kept_session(page)["session"] == secret
