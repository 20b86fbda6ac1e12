"""With blind re-check on, nothing shows the filter's verdict before the answer."""

import re

import numpy as np
import pytest
from playwright.sync_api import expect

from tests.support.page.scenes import GREY
from tests.support.page.stage import layer, wait_for_drawing

pytestmark = [pytest.mark.browser, pytest.mark.long]

VERDICT_WORDS = re.compile(
    r"kept|rejected|threshold|visible|hidden by|\b4 %|96 %|Car|Vegetation"
)


def test_blind_page_shows_and_says_no_verdict_but_of_answered_boxes(scene, user):
    blind = user.open(scene.link("hidden"))
    user.press("b")
    expect(blind.locator(".inspector__head .badge")).to_have_text("hidden")
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
    blind.reload()
    user.wait_until_drawn()
    button = blind.get_by_role("button", name=re.compile("^Blind re-check"))
    expect(button).to_have_attribute("aria-pressed", "true")
    user.open(scene.link("hidden"))
    user.press("a")
    expect(blind.locator(".inspector__head .badge")).to_have_text("rejected")
    expect(blind.locator(".inspector__sentence")).to_contain_text("4 % of its pixels")
    row = blind.locator(f"#box-{scene.box_id('ghost')}")
    expect(row).to_contain_text("hidden until you answer")
    button.click()
    expect(row).not_to_contain_text("hidden until you answer")
