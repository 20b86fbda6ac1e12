"""No serious finding of axe on any view, in either appearance; keyboard and speech."""

from __future__ import annotations

import pytest
from playwright.sync_api import expect

from tests.support.page import crowds
from tests.support.page.accessibility import findings
from tests.support.page.scenes import Scene
from tests.support.page.windows import PHONE, WIDE, Visit, Visitor, lose_session

pytestmark = pytest.mark.browser


@pytest.mark.parametrize("size", [WIDE, PHONE], ids=["wide", "phone"])
def test_frame_with_answers_has_no_serious_finding(
    scene: Scene, visit: Visit, scheme, size
):
    ada = visit(color_scheme=scheme, viewport=size)
    page = ada.open(scene.link("ghost"))
    ada.press("a", "j", "x", "j", "Space", "ArrowLeft", "m")
    ada.saved()

    assert findings(page) == []


def test_lists_have_no_serious_finding(scene, visit, scheme):
    ada = visit(color_scheme=scheme)
    page = ada.open("#/datasets")
    expect(page.get_by_role("heading", name=scene.dataset)).to_be_visible()
    assert findings(page) == []

    ada.open(f"#/datasets/{scene.dataset}/frames?verdict=rejected")
    expect(page.locator("a.thumb")).to_have_count(1)
    assert findings(page) == []


def test_menu_help_and_sign_in_have_no_serious_finding(scene, visit, scheme):
    ada = visit(color_scheme=scheme)
    page = ada.open(scene.link())
    page.get_by_role("button", name="Settings").click()
    assert findings(page) == []
    ada.press("Escape", "?")
    assert findings(page) == []
    ada.press("Escape")
    lose_session(page)
    page.reload()
    expect(page.get_by_label("Token")).to_be_visible()

    assert findings(page) == []


def test_conflict_and_offline_have_no_serious_finding(scene, visit, scheme):
    ada = visit(color_scheme=scheme)
    page = ada.open(scene.link("ghost"))
    body = {"verdict": "reject", "seen_revision": 0}
    scene.api.post(f"/boxes/{scene.box_id('ghost')}/reviews", json=body)
    ada.press("a")
    expect(page.locator(".conflict")).to_be_visible()
    assert findings(page) == []

    page.context.set_offline(True)
    ada.press("j", "a")
    expect(page.locator(".savestate")).to_contain_text("offline")

    assert findings(page) == []


@pytest.mark.parametrize("size", [WIDE, PHONE], ids=["wide", "phone"])
def test_grid_and_its_states_have_no_serious_finding(scene, visit, scheme, size):
    ada = visit(color_scheme=scheme, viewport=size)
    page = ada.open(crowds.grid(scene))
    expect(crowds.cell(page, 0).locator("img")).to_be_visible()
    ada.press("ArrowRight", "Space")
    assert findings(page) == []

    page.context.set_offline(True)
    ada.press("x")
    expect(page.locator(".strip")).to_be_visible()
    assert findings(page) == []
    page.context.set_offline(False)
    ada.open(crowds.grid(scene, distance_min="900"))
    expect(page.get_by_role("heading", name="No box matches")).to_be_visible()

    assert findings(page) == []


@pytest.mark.parametrize("size", [WIDE, PHONE], ids=["wide", "phone"])
def test_queue_and_its_states_have_no_serious_finding(scene, visit, scheme, size):
    ada = visit(color_scheme=scheme, viewport=size)
    page = ada.open(crowds.queue(scene))
    shown = page.locator(".stage[data-picture=shown]")
    expect(shown).to_be_visible()
    crowds.review(scene, scene.box_id(crowds.queued(page)), "reject")
    ada.press("a", "x")
    expect(page.locator(".conflict")).to_be_visible()
    assert findings(page) == []
    ada.press("b")
    assert findings(page) == []

    ada.press("a", "x", "a")

    expect(page.get_by_role("heading", name="All done")).to_be_visible()
    assert findings(page) == []


@pytest.mark.parametrize("size", [WIDE, PHONE], ids=["wide", "phone"])
def test_opened_filters_have_no_serious_finding(scene, visit, scheme, size):
    ada = visit(color_scheme=scheme, viewport=size)
    page = ada.open(crowds.grid(scene, **{"class": "car", "toss_up": "true"}))
    if size == PHONE:
        page.get_by_role("button", name="Filters", exact=True).click()
    page.get_by_role("button", name="More").click()
    expect(page.get_by_role("group", name="More filters")).to_be_visible()
    assert findings(page) == []

    ada.open(crowds.queue(scene, verdict="rejected"))
    if size == PHONE:
        page.get_by_role("button", name="Filters", exact=True).click()
    expect(page.get_by_role("combobox", name="Reason")).to_be_visible()
    assert findings(page) == []


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
    for _ in range(30):  # once round, from wherever the browser begins
        ada.press("Tab")
        if page.evaluate(f"{focused} !== document.body"):
            outlines.append(page.evaluate(f"getComputedStyle({focused}).outlineStyle"))

    assert len(outlines) > 20
    assert set(outlines) <= {"solid", "auto"}


def test_what_happens_is_said(scene, ada):
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
