"""The queue's question: its object, what hides it, other layers, and the depths."""

import numpy as np
import pytest
from playwright.sync_api import expect

from tests.support import sensors
from tests.support.page import scenes
from tests.support.page.accessibility import findings
from tests.support.page.many_boxes import open_queue
from tests.support.page.stage import layer, view, wait_for_drawing
from tests.support.pictures import png

pytestmark = pytest.mark.browser

NEAR = {"id": "214", "class": "car", "xyxy": scenes.CAR, "distance": 30}
GHOST = {"id": "218", "class": "car", "xyxy": [150, 240, 162, 246], "distance": 177}


@pytest.fixture
def hidden(make_scene):
    return make_scene(boxes=[NEAR, GHOST])


def ask(user, scene, name, **query):
    return open_queue(user, scene, boxes=str(scene.box_id(name)), **query)


def test_question_names_what_hides_the_object_and_the_rule_beside_a_close_up(
    hidden, user
):
    page = ask(user, hidden, "218")
    question, stage = page.locator(".question__ask"), page.locator(".stage")
    words = "Can you see any of this car? 12 × 6 px, 177 m away"
    expect(question).to_have_text(f"{words}, inside car 214 at 30 m")
    expect(stage).to_have_attribute("data-hider", str(hidden.box_id("214")))
    wait_for_drawing(page)
    # The close-up is not dimmed, and shows enough to recognise the place.
    drawn = layer(page, "base")
    scale, *_ = view(page)
    assert min(drawn.shape[:2]) / scale >= 96
    assert drawn[10, 10].tolist() == [scenes.GREY] * 3 + [255]
    assert layer(page, "top").any()

    page.keyboard.down("h")
    expect(stage).to_have_attribute("data-bare", "true")
    wait_for_drawing(page)
    bare = layer(page, "top")
    page.keyboard.up("h")

    assert not bare.any()
    expect(stage).not_to_have_attribute("data-bare", "true")
    wait_for_drawing(page)
    assert layer(page, "top").any()

    rule = page.locator(".question__rule")
    expect(rule).to_contain_text("Keep the box if you see")
    own = {"rule": "Wheels alone are enough."}
    hidden.http.patch(f"/datasets/{hidden.dataset}", json=own).raise_for_status()
    page.reload()
    expect(rule).to_have_text("Rule Wheels alone are enough.")

    page = ask(user, hidden, "218", blind="on")
    expect(question).to_have_text(words)
    expect(stage).to_have_attribute("data-hider", "")


@pytest.fixture
def measured(make_scene):
    """A scene of a near car and one hidden behind it, with depth and instances."""
    scene = make_scene(boxes=[])
    shown = png(np.full((sensors.HEIGHT, sensors.WIDTH, 3), scenes.GREY, np.uint8))
    files = {"image": shown, **sensors.sensors()}
    frame = scenes.put(scene.http, scene.dataset, "a", sensors.ANNOTATION, **files)
    return scenes.Scene(scene.http, scene.dataset, frame)


def test_other_layers_show_the_same_cut_and_depths_share_one_axis(measured, user):
    page = ask(user, measured, "218")

    cuts = page.locator(".layers__cut")
    expect(cuts).to_have_text(["segmentation", "depth", "instances"])
    expect(cuts.locator("img")).to_have_count(3)
    expect(page.locator(".depths__words")).to_contain_text(
        "Box 38 to 42 m, pixels 8.0 m: "
    )
    assert findings(page) == []
    box = page.locator(".depths__box").bounding_box()
    band = page.locator(".depths__band").first.bounding_box()
    assert band["x"] + band["width"] < box["x"]


def test_address_of_the_queue_names_its_box_and_opens_at_it(hidden, user):
    page = open_queue(user, hidden, order="random")
    user.press("j")
    second = page.locator(".stage").get_attribute("data-box")
    address = page.evaluate("location.hash")
    assert f"box={second}" in address

    page = user.open(address)
    page.reload()

    expect(page.locator(".stage")).to_have_attribute("data-box", second)
    expect(page.locator(".strip-list__box")).to_have_count(2)


def test_lesson_says_after_each_answer_whether_it_was_right_and_why(
    make_scene, user, http
):
    scene = make_scene(boxes=[], config={"evidence": "auto"})
    at = f"/datasets/{scene.dataset}"
    http.patch(at, json={"coached": True}).raise_for_status()
    http.put(f"{at}/frames/lesson", files=sensors.lesson()).raise_for_status()
    page = user.open(f"#{at}/queue")
    coach = page.locator(".coach")
    expect(coach).to_contain_text("Box 1 of 5 to learn by.")
    expect(page.get_by_text("hidden until you have answered")).to_be_visible()

    user.press("a")
    expect(coach).to_contain_text("Right, keep it: 8\u2009000 pixels of this car")
    page.get_by_role("button", name="Next box").click()
    user.press("x")
    expect(coach).to_contain_text("Right, a ghost: none of the 8\u2009000 pixels")
    user.press("x")  # the same answer again goes on
    expect(coach).to_contain_text("Box 3 of 5 to learn by.")
    user.press("x")
    expect(coach).to_contain_text("Keep it: 800 pixels of this car")
    assert findings(page) == []

    page.reload()
    expect(coach).to_contain_text("Keep it: 800 pixels of this car")
    user.press("j")
    expect(coach).to_contain_text("Box 4 of 5 to learn by.")
    page.get_by_role("button", name="Skip the lesson").click()
    expect(coach).to_be_hidden()
