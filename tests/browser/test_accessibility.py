"""Use by keyboard alone, visible focus, and announcements to screen readers.

The checks of axe are in `test_every_view`.
"""

from __future__ import annotations

import pytest
from playwright.sync_api import expect

from tests.support.page.windows import Visitor

pytestmark = pytest.mark.browser


def test_a_frame_is_reviewed_by_keyboard_alone(scene, ada: Visitor):
    page = ada.open("#/datasets")
    page.get_by_role("link", name=scene.dataset).focus()
    ada.press("Enter")
    page.get_by_role("link", name="run/000001").focus()
    ada.press("Enter")
    ada.ready()

    ada.press("Shift+J", "k")

    ada.saved()
    assert scene.review("real")["verdict"] == "keep"


def test_focus_is_always_visible(scene, ada):
    page = ada.open(scene.link("ghost"))
    focused = "document.activeElement"
    outlines = []
    for _ in range(30):  # enough for one round through the page
        ada.press("Tab")
        if page.evaluate(f"{focused} !== document.body"):
            outlines.append(page.evaluate(f"getComputedStyle({focused}).outlineStyle"))

    assert len(outlines) > 20
    assert set(outlines) <= {"solid", "auto"}


def test_events_are_announced_to_screen_readers(scene, ada):
    page = ada.open(scene.link("real"))
    spoken = page.locator(".sr-only[aria-live]")

    ada.press("j")
    expect(spoken).to_have_text(
        "car hidden, rejected: 4 % Car < 10 % · hidden by Vegetation 96 %"
    )
    ada.press("a")
    expect(spoken).to_have_text("car hidden: keep")
    ada.press("z")
    expect(spoken).to_have_text("car hidden: answer undone")


def test_skip_link_leads_to_the_content(scene, ada):
    page = ada.open(scene.link())
    address = page.url
    page.get_by_role("link", name="Skip to content").focus()

    ada.press("Enter")

    expect(page.locator("main")).to_be_focused()
    assert page.url == address
