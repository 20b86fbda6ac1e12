"""A phone: answers by swiping, and targets that a finger can hit."""

from collections.abc import Sequence

import pytest
from playwright.sync_api import CDPSession, Locator, expect

from tests.support.page import many_boxes
from tests.support.page.stage import bounds, view
from tests.support.page.windows import PHONE, OpenWindow

pytestmark = pytest.mark.browser

SMALL_TARGETS = """() => [...document.querySelectorAll(
  "button, a.button, .tabs__item, select, summary, input:not([type=range])",
)].filter((target) => target.checkVisibility()).map((target) => {
  const whole = target.closest("label") ?? target;
  const { width, height } = whole.getBoundingClientRect();
  return { width, height, name: target.ariaLabel || target.innerText };
}).filter(({ width, height }) => Math.min(width, height) < 44)"""


def drag(touch: CDPSession, stage: Locator, fingers: Sequence[Sequence[int]]) -> None:
    """Move each finger from the middle of the stage, in steps of px to the right."""
    box = bounds(stage)
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    for step, moved in enumerate(zip(*fingers, strict=True)):
        points = [{"x": x + dx, "y": y, "id": i} for i, dx in enumerate(moved)]
        kind = "touchMove" if step else "touchStart"
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    end = {"type": "touchEnd", "touchPoints": []}
    touch.send("Input.dispatchTouchEvent", end)


def test_fingers_answer_by_swiping_and_hit_every_target(
    twenty_boxes, open_window: OpenWindow
):
    scene = twenty_boxes
    user = open_window(viewport=PHONE, has_touch=True, is_mobile=True)
    page = user.open(many_boxes.queue(scene))
    stage = page.locator(".stage")
    expect(stage).to_have_attribute("data-picture", "shown")
    expect(page.get_by_text("swipe to keep")).to_be_visible()
    assert page.evaluate(SMALL_TARGETS) == []
    touch = page.context.new_cdp_session(page)
    first = many_boxes.queued_box_id(page)

    page.wait_for_function("document.querySelector('.stage').dataset.painted")
    drag(touch, stage, [[0, -30, -60]])
    assert many_boxes.queued_box_id(page) == first
    drag(touch, stage, [[0, -60, -120]])
    expect(page.locator(".inspector__head h2")).not_to_contain_text(first)
    user.wait_until_saved()
    assert scene.review(first)["verdict"] == "reject"

    second = many_boxes.queued_box_id(page)
    drag(touch, stage, [[0, 20, 40], [0, -20, -40]])
    before = view(page)
    drag(touch, stage, [[0, 60, 120]])
    expect(stage).not_to_have_attribute("data-view", " ".join(map(str, before)))
    assert many_boxes.queued_box_id(page) == second

    user.open(scene.link("b0"))
    assert page.evaluate(SMALL_TARGETS) == []
