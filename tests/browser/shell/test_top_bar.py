"""The top bar: who is signed in, and the tabs that lead to a dataset's views."""

import pytest
from playwright.sync_api import expect

from tests.support.page.windows import PHONE

pytestmark = pytest.mark.browser


def test_reviewer_is_named_and_the_tab_is_marked_whose_link_keeps_the_filters(
    scene, user
):
    page = user.open(f"#/datasets/{scene.dataset}/frames?class=car&key=run")
    tabs = page.get_by_role("navigation", name="Dataset")

    current = tabs.locator("[aria-current=page]")

    expect(current).to_have_text("Frames")
    expect(current).to_have_attribute(
        "href", f"#/datasets/{scene.dataset}/frames?class=car"
    )
    expect(page.locator(".who")).to_have_text("Aadmin")
    expect(page.locator(".who")).to_have_attribute("title", "Signed in as admin, admin")


def test_current_tab_is_visible_on_a_phone(scene, open_window):
    page = open_window(viewport=PHONE).open(f"#/datasets/{scene.dataset}/frames")

    tabs = page.get_by_role("navigation", name="Dataset")

    expect(tabs.locator("[aria-current=page]")).to_be_in_viewport(ratio=1)
