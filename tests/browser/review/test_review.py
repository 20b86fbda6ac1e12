"""Answering boxes of a frame: storing, undo, comments, history, refusals, touch."""

import re

import numpy as np
import pytest
from playwright.sync_api import Route, expect

from filter_core.segmentation.palettes import FAMILIES
from tests.support.page import scenes
from tests.support.page.scenes import CAR, Scene, get
from tests.support.page.stage import point, wait_for_drawing
from tests.support.page.windows import FILL, PHONE, Visitor, first_held, route_loaded
from tests.support.pictures import png

pytestmark = pytest.mark.browser


def test_answer_key_stores_its_answer_at_once(scene: Scene, user: Visitor):
    for name, key, verdict in [
        ("ghost", "a", "keep"),
        ("walker", "x", "reject"),
        ("away", "Space", "unsure"),
    ]:
        page = user.open(scene.link(name))
        expect(page.locator(".answerline")).to_have_text("It has no answer.")

        user.press(key)

        expect(page.locator(".answerline")).to_contain_text(f"{verdict} by admin")
        expect(page.locator(".answerline__state")).to_have_text("saved")
        user.wait_until_saved()
        review = scene.review(name)
        assert (review["verdict"], review["revision"]) == (verdict, 1)

    # The filter's own verdict stays beside the effective one.
    page = user.open(scene.link("ghost"))
    expect(page.locator(".inspector__head .badge svg")).to_have_count(1)
    expect(page.locator(".inspector__head .badge")).to_have_text("rejected")
    expect(page.locator(f"#box-{scene.box_id('real')}")).to_contain_text("kept")
    row = page.locator(f"#box-{scene.box_id('ghost')}")
    expect(row.locator(".stroke")).to_have_class(re.compile("stroke--kept"))
    expect(row.get_by_role("img", name="answered keep")).to_be_visible()


def test_undo_removes_the_last_answer_and_restores_the_one_before(scene, user):
    page = user.open(scene.link("ghost"))
    user.press("a")
    user.wait_until_saved()

    user.press("z")

    expect(page.locator(".answerline")).to_have_text("It has no answer.")
    user.wait_until_saved()
    assert (scene.review("ghost"), scene.revision("ghost")) == (None, 2)

    user.press("x", "a", "z")

    expect(page.locator(".answerline")).to_contain_text("reject")
    user.wait_until_saved()
    assert scene.review("ghost")["verdict"] == "reject"


def test_boxes_are_selected_and_answered_with_the_mouse_and_then_by_keys(scene, user):
    page = user.open(scene.link())

    page.mouse.click(*point(page, (CAR[0] + CAR[2]) / 2, (CAR[1] + CAR[3]) / 2))
    page.get_by_role("button", name="Keep").click()

    expect(page.locator(".inspector__head h2")).to_have_text("car real")
    user.wait_until_saved()
    assert scene.review("real")["verdict"] == "keep"

    user.press("Space")  # though the button has the focus
    expect(page.locator(".answerline")).to_contain_text("unsure")

    page.mouse.click(*point(page, 10, 170))  # beside all boxes

    expect(page.locator(".inspector__head h2")).to_have_text("This frame")


LATE_TIMERS = """() => {
  const start = window.setTimeout.bind(window);
  window.setTimeout = (run, ms) => start(run, (ms ?? 0) + 400);
}"""
EARLIER_TIMERS_ARE_DONE = "() => new Promise((done) => setTimeout(done, 50))"


def test_comment_is_stored_with_the_answer_or_flags_its_box_as_unsure(scene, user):
    page = user.open(scene.link("ghost"))
    user.press("x", "e")
    expect(page.get_by_label("Comment")).to_be_focused()

    page.keyboard.type("nothing <b>there</b>")
    user.press("Enter")

    user.wait_until_saved()
    assert scene.review("ghost")["comment"] == "nothing <b>there</b>"
    expect(page.locator(".history__comment")).to_have_text("nothing <b>there</b>")
    user.press("a")
    expect(page.locator(".answerline")).to_contain_text("keep")

    user.open(scene.link("hidden"))
    expect(page.locator(".answerline")).to_have_text("It has no answer.")
    user.press("e")
    page.keyboard.type("look again")
    user.press("Enter")
    user.wait_until_saved()
    review = scene.review("hidden")
    assert (review["verdict"], review["comment"]) == ("unsure", "look again")

    # Formerly a late timer focused the comment again, which then took the keys.
    page.evaluate(LATE_TIMERS)
    user.press("e", "Escape")
    page.evaluate(EARLIER_TIMERS_ARE_DONE)
    expect(page.get_by_label("Comment")).not_to_be_focused()


def test_history_shows_the_filter_and_every_answer(scene, user):
    page = user.open(scene.link("hidden"))
    user.press("a", "x")

    items = page.locator(".history__item")
    expect(items).to_have_count(3)
    expect(items.nth(0)).to_contain_text("admin: reject")
    expect(items.nth(1)).to_contain_text("admin: keep")
    expect(items.nth(2)).to_contain_text(
        "rejected, below threshold · 4 %, threshold 10 %"
    )
    user.wait_until_saved()
    user.press("z", "z")
    expect(items).to_have_count(5)
    expect(items.nth(0)).to_contain_text("admin: undid the answer")
    expect(items.nth(1)).to_contain_text("admin: undid an answer, keep again")


SHOWN_AT = """(skeleton, ms) => {
  for (const animation of skeleton.getAnimations()) {
    animation.pause();
    animation.currentTime = ms;
  }
  return getComputedStyle(skeleton).opacity !== "0";
}"""
HEIGHT = "(element) => element.offsetHeight"


def test_loading_history_keeps_its_height_and_does_not_flash(scene, user):
    held: list[Route] = []
    user.open(scene.link("ghost"))
    history = user.page.locator(".history")
    expect(history.locator(".history__item")).to_have_count(1)
    route_loaded(user.page, "**/history?*", lambda route: held.append(route))

    user.press("j")

    skeleton = history.locator(".skeleton").first
    expect(skeleton).to_be_attached()
    expect(history.locator(".history__item")).to_have_count(0)
    assert [skeleton.evaluate(SHOWN_AT, ms) for ms in (50, 1000)] == [False, True]
    loading = history.evaluate(HEIGHT)
    first_held(user.page, held).continue_()
    expect(history.locator(".history__item")).to_have_count(1)
    assert history.evaluate(HEIGHT) == loading


def test_history_shows_older_entries_and_deleted_measurements(scene, user):
    box_id = scene.box_id("ghost")
    for revision in range(51):
        body = {"verdict": ("keep", "reject")[revision % 2], "seen_revision": revision}
        scene.http.post(f"/boxes/{box_id}/reviews", json=body).raise_for_status()

    page = user.open(scene.link("ghost"))

    items = page.locator(".history__item")
    expect(items).to_have_count(50)
    page.get_by_role("button", name="Older entries").click()
    expect(items).to_have_count(52)
    expect(items.last).to_contain_text("rejected")

    gone = {"verdict": None, "reason": None, "match_percent": None, "threshold": None}
    box_id = scene.box_id("hidden")
    history = get(scene.http, f"/boxes/{box_id}/history")
    items = [entry | gone for entry in history["items"]]
    user.page.route("**/history?*", lambda route: route.fulfill(json={"items": items}))

    user.open(scene.link("hidden"))

    expect(page.locator(".history__item")).to_contain_text(
        "its measurements are no longer stored"
    )


def test_refused_answer_shows_error_and_box_stays_unanswered(scene, user):
    page = user.page
    problem = {"title": "Forbidden", "detail": "viewers cannot review", "status": 403}
    page.route("**/reviews", lambda route: route.fulfill(status=403, json=problem))
    user.open(scene.link("ghost"))

    user.press("a")

    expect(page.get_by_role("alert")).to_have_text(
        re.compile("Not saved: viewers cannot review")
    )
    expect(page.locator(".answerline")).to_have_text("It has no answer.")


def test_box_is_described_in_text_and_numbers(scene, user):
    page = user.open(scene.link("hidden"))
    wait_for_drawing(page)

    panel = page.locator(".panel--inspector")
    expect(panel).to_contain_text("400 of 10\u2009000")
    hider = panel.locator(".hidden-by li").first
    expect(hider).to_contain_text("Vegetation96 %")
    vegetation = "rgb(107, 142, 35)"
    expect(hider.locator(".swatch")).to_have_css("background-color", vegetation)
    expect(panel.locator(".inspector__sentence")).to_contain_text("4 % of its pixels")
    stage = page.get_by_role("img", name="Frame run/000001")
    expect(stage).to_have_attribute(
        "aria-label", re.compile(r"4 % Car < 10 % · hidden by Vegetation 96 %$")
    )


def test_hiding_tag_has_the_colour_of_the_frames_palette(http, user):
    palette = FAMILIES["carla-0.9.10"]
    tags = np.full((scenes.HEIGHT, scenes.WIDTH), palette.tag_of("Vehicle"), np.uint8)
    walker = {"class": "walker", "xyxy": scenes.WALKER}
    files = {"image": scenes.picture(), "segmentation": png(palette.paint(tags))}
    made = http.post("/datasets", json={"name": "older", "palette": palette.name})
    assert made.status_code == 201, made.text
    frame = scenes.put(http, "older", "1", {"boxes": [walker]}, **files)

    page = user.open(f"#/frames/{frame['id']}?box={frame['boxes'][0]['box_id']}")

    hider = page.locator(".hidden-by li").first
    expect(hider).to_contain_text("Vehicle100 %")
    swatch = hider.locator(".swatch")
    expect(swatch).to_have_css("background-color", "rgb(0, 0, 142)")


def test_emptied_comment_field_does_not_hide_a_stored_comment(scene, user):
    page = user.open(scene.link("ghost"))
    field = page.get_by_label("Comment")
    field.fill("x")
    field.fill("")
    page.evaluate("location.hash = '#/datasets'")
    expect(page.get_by_role("heading", name="Datasets")).to_be_visible()
    path = f"/boxes/{scene.box_id('ghost')}/reviews"
    body = {"verdict": "reject", "comment": "behind the bus", "seen_revision": 0}
    assert scene.http.post(path, json=body).status_code == 201

    page.evaluate("(link) => { location.hash = link; }", scene.link("ghost"))
    expect(field).to_have_value("behind the bus")
    user.press("a")

    user.wait_until_saved()
    assert scene.review("ghost")["comment"] == "behind the bus"

    # Preferences can change even if the browser's storage is full.
    page.evaluate(FILL)

    user.press("c")

    expect(page.locator(".stage")).to_have_attribute("data-mode", "crop")


def test_phone_selects_in_list_and_on_stage_and_answers_by_touch(scene, open_window):
    bo = open_window(viewport=PHONE, has_touch=True, is_mobile=True)
    page = bo.open(scene.link())
    expect(page.locator(".panel--list")).to_be_hidden()
    page.get_by_role("button", name=re.compile("^Boxes")).tap()
    page.locator(".box", has_text="ghost").tap()
    page.get_by_role("button", name="Selected box").tap()
    expect(page.locator(".inspector__head h2")).to_have_text("truck ghost")
    x0, y0, x1, y1 = CAR

    page.touchscreen.tap(*point(page, (x0 + x1) / 2, (y0 + y1) / 2))

    expect(page.locator(".inspector__head h2")).to_have_text("car real")
    for name in ("Keep", "Reject"):
        box = page.get_by_role("button", name=name).bounding_box()
        assert min(box["width"], box["height"]) >= 44
    page.get_by_role("button", name="Reject").tap()
    bo.wait_until_saved()
    assert scene.review("real")["verdict"] == "reject"


def test_box_without_a_known_class_has_no_matched_pixels(make_scene, user):
    scene = make_scene(boxes=[{"id": "1", "class": "dragon", "xyxy": scenes.CAR}])

    page = user.open(scene.link("1"))

    expect(page.locator(".facts dt", has_text="Rectangle")).to_be_visible()
    expect(page.locator(".facts dt", has_text="Matched pixels")).to_have_count(0)


def test_address_with_follow_shows_the_newest_frame_until_it_is_stopped(
    make_scene, user
):
    scene = make_scene()
    page = user.open(scene.link(follow="1"))
    following = page.get_by_role("link", name="Following the newest: stop")
    expect(following).to_be_visible()

    for key in ("zz/1", "zz/2"):
        scene.push(key)
        expect(page.get_by_role("heading", level=1)).to_have_text(key)
    following.click()
    expect(following).to_have_count(0)
    scene.push("zz/3")

    page.wait_for_timeout(1500)  # three looks, if it still looked
    expect(page.get_by_role("heading", level=1)).to_have_text("zz/2")
