"""Signing in by a login link or a pasted token, signing out, and expired sessions."""

import hashlib
from uuid import uuid4

import pytest
from playwright.sync_api import Route, expect

from tests.support import databases, plain_http
from tests.support.page.accessibility import findings
from tests.support.page.windows import OpenWindow, first_held, kept_session
from tests.support.waiting import until

pytestmark = pytest.mark.browser


def test_login_link_signs_in_and_stores_no_token_or_code(
    open_window: OpenWindow, server
):
    page = open_window(sign_in=False).page
    link = server.login_link

    page.goto(link)

    expect(page.locator("[data-view=datasets]")).to_be_visible()
    assert page.url == f"{server.url}/#/datasets"
    kept = page.evaluate("JSON.stringify([{...localStorage}, {...sessionStorage}])")
    assert server.token not in kept
    assert link.partition("#code=")[2] not in kept
    assert page.context.cookies() == []
    page.reload()
    expect(page.locator("[data-view=datasets]")).to_be_visible()
    assert page.evaluate("performance.getEntriesByType('navigation')[0].name").endswith(
        "/#/datasets"
    )


def test_browser_history_and_used_login_link_do_not_sign_in(open_window, server):
    page = open_window(sign_in=False).page
    link = server.login_link
    page.goto(f"{server.url}/#/datasets")
    expect(page.get_by_label("Token or login link")).to_be_visible()
    page.goto(link)
    expect(page.locator("[data-view=datasets]")).to_be_visible()
    page.get_by_role("button", name="Settings").click()
    page.get_by_role("button", name="Sign out").click()
    expect(page.get_by_label("Token or login link")).to_be_visible()

    session = page.context.new_cdp_session(page)
    entries = session.send("Page.getNavigationHistory")["entries"]
    assert not any("code=" in entry["url"] for entry in entries)
    page.go_back()
    expect(page.get_by_label("Token or login link")).to_be_visible()
    page.goto(link)
    expect(page.get_by_text("this login link was used already")).to_be_visible()
    expect(page.get_by_text("ask whoever runs this server")).to_be_visible()


@pytest.mark.parametrize("what", ["token", "login_link"])
def test_pasted_token_or_link_signs_in_and_opens_requested_page(
    open_window, server, scene, what
):
    visitor = open_window(sign_in=False)
    page = visitor.page
    page.goto(f"{server.url}/{scene.link('ghost')}")
    expect(page.get_by_label("Token or login link")).to_be_focused()

    page.get_by_label("Token or login link").fill(getattr(server, what))
    visitor.press("Enter")

    visitor.wait_until_drawn()
    expect(page.locator(".inspector__head h2")).to_have_text("truck ghost")


def test_wrong_link_or_token_is_refused_and_can_be_corrected(open_window, server):
    page = open_window(sign_in=False).page
    page.goto(f"{server.url}/#code=wrong")
    expect(page.get_by_role("heading", name="Sign in to Unghost")).to_be_visible()
    failure = page.get_by_role("alert")
    expect(failure).to_contain_text("`unghost login` prints a new one")
    assert "wrong" not in page.url

    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_role("alert")).to_have_text("Paste the token or the link first.")
    page.get_by_label("Token or login link").fill("wrong")
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_role("alert")).not_to_have_text(
        "Paste the token or the link first."
    )

    page.get_by_label("Token or login link").fill(server.token)
    page.get_by_role("button", name="Sign in").click()

    expect(page.locator("[data-view=datasets]")).to_be_visible()


def test_sign_out_ends_the_session_in_every_tab(open_window, server):
    page = open_window(sign_in=False).page  # not the session that other tests share
    page.goto(server.login_link)
    expect(page.locator("[data-view=datasets]")).to_be_visible()
    other = page.context.new_page()
    other.goto(f"{server.url}/#/datasets")
    expect(other.locator("[data-view=datasets]")).to_be_visible()
    secret = kept_session(page)["session"]
    page.get_by_role("button", name="Settings").click()

    page.get_by_role("button", name="Sign out").click()

    expect(page.get_by_label("Token or login link")).to_be_visible()
    expect(other.get_by_label("Token or login link")).to_be_visible()
    assert kept_session(page) is None
    shown = {"Authorization": f"Bearer {secret}"}
    assert plain_http.get(f"{server.url}/version", headers=shown).status_code == 401
    page.reload()
    expect(page.get_by_label("Token or login link")).to_be_visible()

    page.goto(server.login_link)
    expect(other.locator("[data-view=datasets]")).to_be_visible()


def test_api_documentation_needs_no_sign_in(open_window, server):
    page = open_window(sign_in=False).page
    page.emulate_media(color_scheme="dark")
    page.goto(f"{server.url}/docs")
    assert findings(page) == []

    expect(page.get_by_role("heading", level=1)).to_contain_text("API")
    expect(page.get_by_text("/api/v1/login-codes").first).to_be_visible()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("expires_at = '2001-01-01 00:00:00'", "this token expired on 2001-01-01"),
        ("revoked_at = '2001-01-01 00:00:00'", "this token was revoked"),
    ],
)
def test_login_link_of_expired_or_revoked_token_shows_reason(
    open_window, server, http, change, words
):
    token = create_token(server, http)
    link = server.login_link_of(token)
    change_token(server, token, change)
    page = open_window(sign_in=False).page

    page.goto(link)

    expect(page.get_by_role("alert")).to_contain_text(words)


def test_page_reports_that_its_token_expired(open_window, server, http, scene):
    token = create_token(server, http)
    page = open_window(sign_in=False).page
    page.goto(server.login_link_of(token))
    expect(page.locator("[data-view=datasets]")).to_be_visible()

    expire_token(page, server, token)
    page.goto(f"{server.url}/{scene.link()}")

    expect(page.get_by_label("Token or login link")).to_be_visible()
    expect(page.get_by_text("Your token has expired.")).to_be_visible()


def expire_token(page, server, token):
    """Let a token expire, and wait until the server, which caches tokens, notices."""
    # Read before the change: the page drops its session with the first refusal.
    shown = {"Authorization": f"Bearer {kept_session(page)['session']}"}
    change_token(server, token, "expires_at = '2001-01-01 00:00:00'")
    until(
        lambda: not page.request.get(f"{server.url}/api/v1/session", headers=shown).ok
    )


def create_token(server, http):
    name = f"visitor-{uuid4().hex}"
    return http.post("/tokens", json={"name": name}).json()["token"]


def change_token(server, token, to):
    """Change columns of a token in the database, for example to let it expire."""
    digest = hashlib.sha256(token.encode()).hexdigest()
    databases.change(
        server.data, f"update tokens set {to} where hash = :hash", hash=digest
    )


def test_401_for_the_previous_session_keeps_the_new_session(scene, open_window, server):
    user = open_window(sign_in=False)
    page = user.page
    held: list[Route] = []
    page.route(
        "**/reviews", lambda route: route.continue_() if held else held.append(route)
    )
    page.goto(server.login_link)
    user.open(scene.link("ghost"))
    user.press("a")
    held_review = first_held(page, held)
    before = kept_session(page)["session"]
    link = server.login_link.partition("#")[2]
    page.evaluate("(link) => { location.hash = link; }", link)
    until(lambda: kept_session(page)["session"] != before)

    held_review.fulfill(status=401, json={"code": "session_expired", "title": "x"})

    user.wait_until_saved()
    assert scene.review("ghost")["verdict"] == "keep"
    assert kept_session(page) is not None
