"""The page in dark and in light colours, and in windows of any width."""

import re

import pytest
from playwright.sync_api import Page, expect

from tests.support.page.scenes import Scene
from tests.support.page.stage import wait_for_drawing
from tests.support.page.windows import OVERFLOW, Visitor

pytestmark = pytest.mark.browser

BACKGROUND = "getComputedStyle(document.body).backgroundColor"
HIDDEN = """(buttons) => buttons.filter((button) => {
  const { left, right } = button.getBoundingClientRect();
  return button.checkVisibility({ visibilityProperty: true }) &&
    (left < 0 || right > innerWidth || left === right);
}).map((button) => button.innerText)"""
"""The buttons that are not, or only in part, in the window, though they are shown."""


def is_dark(page: Page) -> bool:
    red, *_ = map(int, re.findall(r"\d+", page.evaluate(BACKGROUND)))
    return red < 60


def test_page_follows_the_system_colour_scheme_unless_one_is_chosen(user):
    page = user.page
    page.emulate_media(color_scheme="dark")
    user.open("#/datasets")
    assert is_dark(page)
    page.emulate_media(color_scheme="light")
    assert not is_dark(page)
    page.get_by_role("button", name="Settings").click()

    page.get_by_role("button", name="Dark").click()

    expect(page.locator("html")).to_have_attribute("data-theme", "dark")
    page.reload()
    expect(page.locator("html")).to_have_attribute("data-theme", "dark")
    assert is_dark(page)


def test_nothing_overflows_at_any_window_width(scene: Scene, user: Visitor):
    # The top bar stays from view to view: each view is waited for by its content.
    contents = {
        "#/datasets": ".card",
        f"#/datasets/{scene.dataset}/frames": "a.thumb",
        scene.link("hidden"): ".inspector__head",
    }
    for link, content in contents.items():
        page = user.open(link)
        expect(page.locator(content).first).to_be_visible()
        for width in (360, 390, 768, 1024, 1600):
            page.set_viewport_size({"width": width, "height": 844})
            wait_for_drawing(page)
            assert page.evaluate(OVERFLOW) <= 0, (link, width)
            hidden = page.locator(".topbar button, .bar button").evaluate_all(HIDDEN)
            assert hidden == [], (link, width)
