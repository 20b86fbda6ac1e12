"""Boxes that overlap the selected one are listed and stay visible."""

import pytest
from playwright.sync_api import expect

from tests.support.page.stage import edge_contrast, wait_for_drawing

pytestmark = pytest.mark.browser

NEAR, PART, FAR = [80, 200, 240, 300], [200, 220, 330, 320], [420, 30, 520, 110]
BOXES = [
    {"id": "near", "class": "car", "xyxy": NEAR},
    {"id": "part", "class": "car", "xyxy": PART},
    {"id": "inside", "class": "car", "xyxy": [90, 210, 230, 290]},
    {"id": "far", "class": "car", "xyxy": FAR},
]


def test_overlapping_boxes_are_listed_closest_first_and_dimmed_less(make_scene, user):
    scene = make_scene(boxes=BOXES)
    page = user.open(scene.link("near"))
    wait_for_drawing(page)
    assert edge_contrast(page, PART) > 1.5 * edge_contrast(page, FAR) > 0
    listed = page.get_by_label("Overlapping boxes").get_by_role("button")
    expect(listed).to_have_count(2)
    expect(listed.first).to_contain_text("car inside")

    listed.nth(1).click()

    expect(page.locator(".inspector__head h2")).to_have_text("car part")
