"""With blind re-check on, nothing shows the filter's verdict before the answer."""

import re

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from tests.support.page.scenes import GREY, Scene
from tests.support.page.stage import layer, wait_for_drawing
from tests.support.page.windows import Visitor

pytestmark = [pytest.mark.browser, pytest.mark.long]

VERDICT_WORDS = re.compile(
    r"kept|rejected|threshold|visible|hidden by|\b4 %|96 %|Car|Vegetation"
)


@pytest.fixture
def blind(scene: Scene, user: Visitor) -> Page:
    """The frame view with a rejected box selected, and blind re-check switched on."""
    page = user.open(scene.link("hidden"))
    user.press("b")
    expect(page.locator(".inspector__head .badge")).to_have_text("hidden")
    return page


def test_blind_page_does_not_show_or_say_the_verdict(user, blind):
    panel = blind.locator(".panel--inspector").inner_text()
    rows = blind.locator(".boxes").inner_text()
    stage = blind.locator(".stage").get_attribute("aria-label") or ""

    assert VERDICT_WORDS.findall(f"{panel}\n{rows}\n{stage}") == []
    expect(blind.locator(".history")).to_have_count(0)
    wait_for_drawing(blind)
    base = layer(blind, "base")[..., :3].astype(int)
    top = layer(blind, "top")
    assert np.ptp(base, axis=2).max() < 40, "a colour among greys"
    assert np.ptp(top[top[..., 3] > 200][:, :3].astype(int), axis=1).max() < 40
    assert GREY in base
    user.press("j")
    spoken = blind.locator(".sr-only[aria-live]")
    expect(spoken).to_have_text("truck ghost, hidden until you answer")


def test_answer_reveals_the_verdict_of_its_box_only(scene, user, blind):
    user.press("a")

    expect(blind.locator(".inspector__head .badge")).to_have_text("rejected")
    expect(blind.locator(".inspector__sentence")).to_contain_text("4 % of its pixels")
    row = blind.locator(f"#box-{scene.box_id('ghost')}")
    expect(row).to_contain_text("hidden until you answer")


def test_blind_re_check_is_remembered_and_can_be_switched_off(user, blind):
    blind.reload()
    user.wait_until_drawn()
    button = blind.get_by_role("button", name=re.compile("^Blind re-check"))
    expect(button).to_have_attribute("aria-pressed", "true")

    button.click()

    expect(blind.locator(".inspector__head .badge")).to_have_text("rejected")
