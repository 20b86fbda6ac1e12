"""The list of datasets."""

import re

import pytest
from playwright.sync_api import expect

from tests.support.page.accessibility import findings
from tests.support.page.windows import OVERFLOW

pytestmark = pytest.mark.browser


def test_empty_server_shows_how_to_upload_data(open_window, start_server):
    own = start_server()
    page = open_window(sign_in=False).page

    page.goto(own.login_link)

    expect(page.get_by_role("heading", name="No datasets yet")).to_be_visible()
    expect(page.locator("code").first).to_have_text(
        "unghost push FOLDER --dataset NAME"
    )
    expect(page.get_by_role("button", name=re.compile("^Copy"))).to_have_count(3)
    assert findings(page) == []
    # The longest command is wider than both windows.
    for width in (1440, 390):
        page.set_viewport_size({"width": width, "height": 844})
        assert page.evaluate(OVERFLOW) <= 0, width


def test_home_of_a_dataset_reports_its_ghosts_and_starts_the_review(scene, user):
    page = user.open(f"#/datasets/{scene.dataset}")

    expect(page.get_by_role("row", name="car 3 2")).to_be_visible()
    expect(page.get_by_role("row", name="0 to 50 m 2 1")).to_be_visible()
    expect(page.get_by_role("link", name="0 to 50 m")).to_have_attribute(
        "href", re.compile("distance_max=50")
    )
    expect(page.get_by_role("row", name="outside the image 1")).to_be_visible()
    expect(page.get_by_role("link", name="run/000001")).to_contain_text("3 ghosts")
    page.get_by_role("link", name="Start review").click()
    expect(page.locator("[data-view=queue]")).to_be_visible()


def test_slider_of_any_frame_is_a_link_that_a_guest_can_open(
    scene, user, open_window, http
):
    page = user.open(scene.link())
    page.get_by_role("link", name="Before and after").click()
    expect(page).to_have_url(re.compile(r"/compare$"))
    before = page.locator("#compare-before rect")
    expect(page.locator(".compare__box--raw")).to_have_count(4)
    expect(page.locator(".compare__box--kept")).to_have_count(2)
    expect(before).to_have_attribute("width", "320")

    page.get_by_role("slider").focus()
    user.press("End")

    expect(before).to_have_attribute("width", "640")
    expect(page.get_by_text("Before: 4 boxes")).to_be_visible()

    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.get_by_role("button", name="Copy link").click()
    expect(page.get_by_role("button", name="Copied")).to_be_visible()
    link = page.evaluate("navigator.clipboard.readText()")
    token = http.post("/tokens", json={"name": "guest", "role": "viewer"}).json()
    guest = open_window(sign_in=False).page
    guest.goto(link)
    guest.get_by_label("Token or login link").fill(token["token"])
    guest.get_by_role("button", name="Sign in").click()
    expect(guest.locator(".compare__box--kept")).to_have_count(2)
    expect(guest.locator(".tabs [aria-current]")).to_have_text("Frames")
    page.get_by_role("button", name="Link for a guest").click()

    expect(page.get_by_text("Link copied. It works once")).to_be_visible()
    guest = open_window(sign_in=False).page
    guest.goto(page.evaluate("navigator.clipboard.readText()"))
    expect(guest.locator(".compare__box--kept")).to_have_count(2)
    expect(guest).to_have_url(re.compile(r"#/frames/\d+/compare$"))
    expect(guest.get_by_role("button", name="Copy link")).to_be_visible()
    expect(guest.get_by_role("button", name="Link for a guest")).to_have_count(0)


def test_home_of_a_dataset_shows_frames_while_they_come_in(http, make_scene, user):
    scene = make_scene(boxes=[])
    page = user.open(f"#/datasets/{scene.dataset}")
    expect(page.get_by_role("heading", name="No boxes yet")).to_be_visible()

    scene.push("run/000002")

    expect(page.get_by_role("link", name="run/000002")).to_be_visible()

    user.open(f"#/datasets/{scene.dataset}/frames")
    shown = page.locator("a.thumb")
    expect(shown).to_have_count(2)
    page.evaluate("document.querySelector('a.thumb').dataset.seen = 'before'")
    scene.push("run/000000")
    expect(shown).to_have_count(3)
    expect(shown.nth(0)).to_have_attribute("data-seen", "before")
    expect(shown.nth(2)).to_contain_text("run/000000")
    expect(page.locator(".page__count")).to_have_text("3 frames")
