"""Dark and light, window widths, touch, and the states empty, loading and failing."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import expect

from tests.support.page.accessibility import findings
from tests.support.page.scenes import Scene
from tests.support.page.stage import view, wait_for_drawing
from tests.support.page.windows import OVERFLOW, PHONE, OpenWindow, Visitor

pytestmark = pytest.mark.browser

BACKGROUND = "getComputedStyle(document.body).backgroundColor"
IN_SIGHT = """(element) => {
  const { left, right, width } = element.getBoundingClientRect();
  return width > 0 && left >= 0 && right <= innerWidth;
}"""


@pytest.mark.parametrize(("scheme", "is_dark"), [("dark", True), ("light", False)])
def test_page_follows_the_system_colour_scheme(
    open_window: OpenWindow, scheme, is_dark
):
    page = open_window(color_scheme=scheme).open("#/datasets")

    red, *_ = map(int, re.findall(r"\d+", page.evaluate(BACKGROUND)))
    assert (red < 60) == is_dark


def test_chosen_colour_scheme_overrides_system_and_is_remembered(open_window):
    page = open_window(color_scheme="light").open("#/datasets")
    page.get_by_role("button", name="Settings").click()

    page.get_by_role("button", name="Dark").click()

    expect(page.locator("html")).to_have_attribute("data-theme", "dark")
    page.reload()
    expect(page.locator("html")).to_have_attribute("data-theme", "dark")
    red, *_ = map(int, re.findall(r"\d+", page.evaluate(BACKGROUND)))
    assert red < 60


WIDTHS_BETWEEN = [pytest.param(px, marks=pytest.mark.long) for px in (390, 768, 1024)]


@pytest.mark.parametrize("width", [360, *WIDTHS_BETWEEN, 1600])
def test_nothing_overflows_at_any_window_width(
    scene: Scene, open_window: OpenWindow, width
):
    user = open_window(viewport={"width": width, "height": 844})
    links = ["#/datasets", f"#/datasets/{scene.dataset}/frames", scene.link("hidden")]
    for link in links:
        page = user.open(link)
        expect(page.locator(".topbar")).to_be_visible()
        assert page.evaluate(OVERFLOW) <= 0, link
        for button in page.locator(".topbar button, .bar button").all():
            if button.is_visible():
                assert button.evaluate(IN_SIGHT), (link, button.inner_text())


def test_phone_toggles_list_and_box_and_answers_by_touch(scene, open_window):
    bo = open_window(viewport=PHONE, has_touch=True, is_mobile=True)
    page = bo.open(scene.link())
    expect(page.locator(".panel--list")).to_be_hidden()
    page.get_by_role("button", name=re.compile("^Boxes")).tap()
    page.locator(".box", has_text="ghost").tap()
    page.get_by_role("button", name="Selected box").tap()
    expect(page.locator(".inspector__head h2")).to_have_text("truck ghost")

    keep = page.get_by_role("button", name="Keep")
    assert keep.bounding_box()["height"] >= 44
    keep.tap()

    bo.wait_until_saved()
    assert scene.review("ghost")["verdict"] == "keep"


def test_pinch_gesture_zooms(scene, open_window):
    bo = open_window(viewport=PHONE, has_touch=True, is_mobile=True)
    page = bo.open(scene.link())
    before, *_ = view(page)

    page.evaluate(PINCH)
    wait_for_drawing(page)

    assert view(page)[0] == pytest.approx(2 * before, rel=0.01)


PINCH = """() => {
  const stage = document.querySelector(".stage");
  const { left, top } = stage.getBoundingClientRect();
  stage.setPointerCapture = () => {};
  const send = (type, pointerId, x) => stage.dispatchEvent(new PointerEvent(type,
    { pointerId, button: 0, clientX: left + x, clientY: top + 150, bubbles: true }));
  send("pointerdown", 1, 150);
  send("pointerdown", 2, 200);
  send("pointermove", 2, 225);
  send("pointermove", 1, 125);
  send("pointerup", 1, 125);
  send("pointerup", 2, 225);
}"""


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


def test_failed_dataset_list_shows_error_and_can_be_retried(scene, user: Visitor):
    page = user.page
    page.route("**/api/v1/datasets?*", lambda route: route.abort())
    page.goto(f"{user.url}/#/frames/{scene.frame['id']}")
    page.goto(f"{user.url}/#/datasets")
    expect(page.get_by_role("alert")).to_have_text("The server does not answer.")

    page.unroute("**/api/v1/datasets?*")
    page.get_by_role("button", name="Try again").click()

    expect(page.get_by_role("heading", name=scene.dataset)).to_be_visible()


def test_frame_without_segmentation_offers_no_mask(make_scene, user):
    page = user.open(make_scene(form="none").link())

    expect(page.get_by_role("toolbar", name="View")).to_be_visible()
    expect(page.get_by_role("button", name="Segmentation")).to_have_count(0)
    expect(page.locator(".stroke--unmeasured").first).to_be_visible()
