"""What each key of the keymap does, and that the help lists every binding."""

import json
import re

import pytest
from playwright.sync_api import Page, expect

from tests.support.page import scenes
from tests.support.page.stage import view, wait_for_drawing

pytestmark = pytest.mark.browser


def heading(page: Page):
    return page.locator(".inspector__head h2")


def pressed(page: Page, name: str):
    return page.get_by_role("button", name=name, exact=True)


def test_next_previous_and_arrow_keys_select_the_adjacent_box(scene, user):
    page = user.open(scene.link())

    for keys, selected in [
        (["j"], "real"),
        (["j"], "hidden"),
        (["ArrowLeft"], "real"),
        (["Escape", "ArrowLeft"], "away"),
    ]:
        user.press(*keys)
        expect(heading(page)).to_contain_text(selected)
        expect(page.locator("[aria-selected=true]")).to_contain_text(selected)

    page.get_by_role("listbox").focus()
    user.press("ArrowUp", "ArrowUp", "ArrowDown")
    expect(heading(page)).to_contain_text("walker")

    user.press("Escape", "j", "j", "x", "ArrowLeft")
    expect(heading(page)).to_contain_text("real")
    user.press("Shift+J")
    expect(heading(page)).to_contain_text("ghost")  # the next one without an answer


def test_keys_zoom_to_the_selected_box_in_and_back(scene, user):
    page = user.open(scene.link("real"))
    fitted, *_ = view(page)

    user.press("c")
    wait_for_drawing(page)
    cropped, *_ = view(page)
    assert cropped > 1.3 * fitted
    user.press("j")
    wait_for_drawing(page)
    scale, x, y = view(page)
    left, top, right, bottom = scenes.HALF_HIDDEN
    stage = page.locator(".stage").bounding_box()
    middle = ((left + right) / 2 * scale + x, (top + bottom) / 2 * scale + y)
    assert middle == pytest.approx((stage["width"] / 2, stage["height"] / 2), abs=1)
    user.press("c")
    wait_for_drawing(page)

    assert view(page)[0] == pytest.approx(fitted)

    before = view(page)
    user.press("+", "+")
    wait_for_drawing(page)
    assert view(page)[0] > 1.5 * fitted
    user.press("-")
    user.press("f")
    wait_for_drawing(page)
    assert view(page) == pytest.approx(before)


def test_layer_keys_change_layers_for_good_unless_typed_into_a_field(scene, user):
    page = user.open(scene.link("real"))
    mask = pressed(page, "Segmentation over the image")
    highlight = pressed(page, "Highlight the matching pixels")
    expect(mask).to_have_attribute("aria-pressed", "false")
    expect(highlight).to_have_attribute("aria-pressed", "true")

    user.press("m")
    expect(mask).to_have_attribute("aria-pressed", "true")
    user.press("l")
    expect(highlight).to_have_attribute("aria-pressed", "false")
    user.press("]", "]", "[")
    opacity = page.get_by_role("slider", name="Segmentation opacity")
    expect(opacity).to_have_value("0.6")

    page.reload()
    expect(mask).to_have_attribute("aria-pressed", "true")
    expect(highlight).to_have_attribute("aria-pressed", "false")
    expect(opacity).to_have_value("0.6")

    user.open(scene.link("ghost"))
    page.get_by_label("Comment").click()

    page.keyboard.type("axrz jv")

    expect(page.get_by_label("Comment")).to_have_value("axrz jv")
    user.wait_until_saved()
    assert scene.review("ghost") is None


UNUSED = ".help__row.is-off dt"


def test_help_lists_every_binding_and_marks_those_not_used_in_a_view(scene, user):
    page = user.open(scene.link("ghost", verdict="rejected"))
    user.press("?")

    dialog = page.get_by_role("dialog", name="Keys")
    expect(dialog).to_be_visible()
    table = page.evaluate(
        "async () => (await import('/static/js/core/keymap.js')).KEYMAP"
        ".map((row) => [row.help, row.keys.join(' or ')])"
    )
    shown = dialog.locator(".help__row").evaluate_all(
        "(rows) => rows.map((row) => [row.querySelector('dt').firstChild.textContent,"
        " row.querySelector('dd .sr-only').textContent])"
    )
    assert sorted(shown) == sorted(table)
    rows = page.locator(UNUSED).all_text_contents()
    assert "Remove the answers (not in this view)" in rows
    assert not [row for row in rows if row.startswith(("Keep", "Next frame"))]
    user.press("?")
    expect(dialog).to_be_hidden()

    user.press("g")
    expect(page.locator(".cell")).to_have_count(3)
    assert page.url.endswith(f"#/datasets/{scene.dataset}/grid?verdict=rejected")
    user.press("?")
    expect(dialog).to_be_visible()
    rows = page.locator(UNUSED).all_text_contents()
    assert "Next frame (not in this view)" in rows
    assert not [row for row in rows if row.startswith(("Keep", "Remove the answers"))]
    user.press("?")
    expect(dialog).to_be_hidden()

    user.press("g")
    expect(page.locator("[data-view=frames] h1")).to_have_text(scene.dataset)
    assert page.url.endswith(f"#/datasets/{scene.dataset}/frames?verdict=rejected")


def test_answer_key_can_be_rebound_and_a_key_taken_from_another_is_reported(
    scene, user
):
    page = user.open(scene.link("ghost"))
    user.press("?")
    row = page.locator(".help__row", has_text="Reject the box")
    row.hover()
    row.get_by_role("button").click()
    user.press("m")
    expect(page.get_by_role("dialog").get_by_role("status")).to_have_text(
        "M is no longer a key for: Segmentation over the image, which has no key now"
    )
    row.get_by_role("button").click()
    user.press("q", "Escape")
    expect(page.get_by_role("dialog")).to_be_hidden()

    user.press("x")
    expect(page.locator(".answerline")).to_have_text("It has no answer.")
    user.press("q")

    expect(page.locator(".answerline")).to_contain_text("reject")
    expect(page.get_by_role("button", name=re.compile("^Reject"))).to_contain_text("Q")


def change_keys(page: Page, **keys: str) -> None:
    """Store these keys of actions as the help does, and load the page again."""
    settings = {"off": False, "keys": {action: [key] for action, key in keys.items()}}
    page.evaluate(
        "(text) => localStorage.setItem('unghost.keys.v1', text)", json.dumps(settings)
    )
    page.reload()


def test_tooltips_and_hints_of_the_grid_show_changed_keys(scene, user):
    page = user.open(f"#/datasets/{scene.dataset}/grid")
    cells = page.locator(".cell")
    expect(cells).to_have_count(5)
    opens = page.locator(".cell__open").first
    expect(opens).to_have_attribute("title", "Open in its frame (C)")
    user.press("?")
    page.get_by_label("Single-key shortcuts").uncheck()
    user.press("Escape")
    expect(opens).to_have_attribute("title", "Open in its frame")

    change_keys(page, select="S", open="Y", escape="Q", help="H")

    expect(page.locator(".grid-status__hint")).to_have_text("Click, drag or S selects")
    expect(opens).to_have_attribute("title", "Open in its frame (Y)")
    user.press("x")
    expect(page.locator(".toast")).to_have_text(
        "Select boxes first: click, drag, or press S."
    )
    user.press("s")
    none = page.get_by_role("button", name="Select none")
    expect(none).to_have_attribute("title", "Select none (Q)")
    page.get_by_role("button", name="Settings").click()
    expect(page.locator(".menu__item kbd")).to_have_text("H")
    user.press("h")
    expect(page.get_by_role("dialog", name="Keys")).to_be_visible()
    user.press("h")
    expect(page.get_by_role("dialog", name="Keys")).to_be_hidden()
    user.press("y")
    expect(page.locator(".stage")).to_be_visible()
