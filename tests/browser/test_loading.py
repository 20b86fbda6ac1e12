"""What the page loads: little at first, the rest with the view that needs it."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import expect

pytestmark = pytest.mark.browser

LOADED = "() => performance.getEntriesByType('resource').map(({ name }) => name)"


def test_first_view_loads_no_other_views_modules(scene, ada):
    page = ada.open(f"#/datasets/{scene.dataset}/frames")
    expect(page.locator("a.thumb")).to_have_count(1)

    loaded = page.evaluate(LOADED)

    assert any(name.endswith("/datasets/frames.js") for name in loaded)
    others = re.compile("/stage/|uplot.*js|/queue/")
    assert list(filter(others.search, loaded)) == []


def test_view_that_cannot_be_loaded_says_so_and_comes_when_asked_again(scene, ada):
    page = ada.open(f"#/datasets/{scene.dataset}/frames")
    page.route("**/review/frame.js", lambda route: route.abort())
    page.locator("a.thumb").click()
    expect(page.get_by_role("alert")).to_be_visible()

    page.unroute("**/review/frame.js")
    page.get_by_role("button", name="Try again").click()

    expect(page.locator("h1")).to_have_text("run/000001")


def test_view_stays_the_same_when_its_address_changes(scene, ada):
    page = ada.open(scene.link("ghost"))
    page.locator(".stage").evaluate("(stage) => { stage.mark = 'same'; }")

    ada.press("j")

    expect(page.locator(".inspector__head h2")).to_have_text("walker walker")
    assert page.locator(".stage").evaluate("(stage) => stage.mark") == "same"
