"""Use by keyboard alone, visible focus, and announcements to screen readers.

The checks of axe are in `test_every_view`.
"""

import pytest
from playwright.sync_api import expect

from tests.support.page.windows import Visitor

pytestmark = pytest.mark.browser


def test_frame_can_be_reviewed_by_keyboard_only(scene, user: Visitor):
    page = user.open("#/datasets")
    page.get_by_role("link", name=scene.dataset).focus()
    user.press("Enter")
    page.get_by_role("link", name="Look at the frames").focus()
    user.press("Enter")
    page.get_by_role("link", name="run/000001").focus()
    user.press("Enter")
    user.wait_until_drawn()

    user.press("Shift+J", "k")

    user.wait_until_saved()
    assert scene.review("real")["verdict"] == "keep"


def test_events_are_announced_and_focus_is_always_visible(scene, user):
    page = user.open(scene.link("real"))
    spoken = page.locator(".sr-only[aria-live]")

    user.press("j")
    expect(spoken).to_have_text(
        "car hidden, rejected: 4 % Car < 10 % · hidden by Vegetation 96 %"
    )
    user.press("a")
    expect(spoken).to_have_text("car hidden: keep")
    user.press("z")
    expect(spoken).to_have_text("car hidden: answer undone")

    address = page.url
    page.get_by_role("link", name="Skip to content").focus()
    user.press("Enter")
    expect(page.locator("main")).to_be_focused()
    assert page.url == address

    user.open(scene.link("ghost"))
    focused = "document.activeElement"
    outlines = []
    for _ in range(30):  # enough for one round through the page
        user.press("Tab")
        if page.evaluate(f"{focused} !== document.body"):
            outlines.append(page.evaluate(f"getComputedStyle({focused}).outlineStyle"))

    assert len(outlines) > 20
    assert set(outlines) <= {"solid", "auto"}
