"""The queue asks about boxes in doubt; the others are in bins that the grid answers."""

import re

import pytest
from playwright.sync_api import Page, expect

from tests.support.page import many_boxes, scenes
from tests.support.page.many_boxes import answers, queue, queued_box_id
from tests.support.page.scenes import MakeScene, Scene
from tests.support.page.windows import Visitor

pytestmark = pytest.mark.browser

TWINS = [
    {"id": name, "class": "car", "xyxy": scenes.CAR, "distance": distance}
    for name, distance in (("near", 10), ("far", 20))
]


@pytest.fixture
def street(make_scene: MakeScene) -> Scene:
    """Two boxes to review, one outside of the image, and two walls."""
    outside = {"id": "outside", "class": "car", "xyxy": [-50, 0, -9, 9]}
    walls = many_boxes.alternating_boxes(4)[1::2]
    return make_scene(boxes=[*TWINS, outside, *walls])


def progress(page: Page):
    return page.locator(".queue__progress")


def test_boxes_to_review_are_asked_about_and_bins_at_the_end_are_answered_at_once(
    street, user: Visitor
):
    page = user.open(queue(street, bin=""))
    expect(progress(page)).to_contain_text("0 answered · 2 to review")
    other = {"near": "the farther car far", "far": "the nearer car near"}
    expect(page.locator(".inspector__question")).to_contain_text(
        f"kept by its tags, but {other[queued_box_id(page)]} covers 100 % of it"
    )
    # A box that somebody was unsure about is still to be reviewed.
    expect(page.locator(".stage")).to_have_attribute("data-picture", "shown")
    user.press("u")
    expect(progress(page)).to_contain_text("1 answered · 2 to review")
    user.press("z")
    expect(progress(page)).to_contain_text("0 answered · 2 to review")
    user.open(f"#/datasets/{street.dataset}/frames")
    expect(page.locator(".page__head")).to_contain_text("2 need review")
    expect(page.locator("a.thumb")).to_contain_text("2 need review")

    user.open(queue(street, bin=""))
    for left in (1, 0):
        expect(page.locator(".stage")).to_have_attribute("data-picture", "shown")
        user.press("a")
        expect(progress(page)).to_contain_text(f"{left} to review")

    bins = page.locator(".bins")
    expect(bins).to_contain_text("1 left to the filter")
    bins.get_by_text(re.compile("2 without a single pixel")).click()

    expect(page.locator(".cell")).to_have_count(2)
    user.press("Control+a")
    user.press("x")
    expect(page.locator(".toast").last).to_contain_text("2 boxes rejected")
    kept = {"near": "keep", "far": "keep"}
    assert answers(street) == kept | {"b1": "reject", "b3": "reject"}
    user.press("z")
    expect(page.locator(".toast").last).to_contain_text("undone")
    assert answers(street) == kept
