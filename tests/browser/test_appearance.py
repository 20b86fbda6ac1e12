"""The page in dark and in light colours, and in windows of any width."""

import re

import pytest
from playwright.sync_api import Page, expect

from tests.support.page.scenes import Scene
from tests.support.page.windows import OVERFLOW, OpenWindow

pytestmark = pytest.mark.browser

BACKGROUND = "getComputedStyle(document.body).backgroundColor"
IN_SIGHT = """(element) => {
  const { left, right, width } = element.getBoundingClientRect();
  return width > 0 && left >= 0 && right <= innerWidth;
}"""


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


WIDTHS_BETWEEN = [pytest.param(px, marks=pytest.mark.long) for px in (390, 768, 1024)]


@pytest.mark.parametrize("width", [360, *WIDTHS_BETWEEN, 1600])
def test_nothing_overflows_at_any_window_width(
    scene: Scene, open_window: OpenWindow, width
):
    user = open_window(viewport={"width": width, "height": 844})
    # The top bar stays from view to view: each view is waited for by its content.
    contents = {
        "#/datasets": ".card",
        f"#/datasets/{scene.dataset}/frames": "a.thumb",
        scene.link("hidden"): ".inspector__head",
    }
    for link, content in contents.items():
        page = user.open(link)
        expect(page.locator(content).first).to_be_visible()
        assert page.evaluate(OVERFLOW) <= 0, link
        for button in page.locator(".topbar button, .bar button").all():
            if button.is_visible():
                assert button.evaluate(IN_SIGHT), (link, button.inner_text())
