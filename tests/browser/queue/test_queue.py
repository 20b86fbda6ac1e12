"""The queue shows one box at a time: answering, undo, keys, orders, and its end."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from tests.support.page import many_boxes, scenes
from tests.support.page.many_boxes import answers, open_queue, queue, queued_box_id
from tests.support.page.stage import bounds, layer, wait_for_drawing
from tests.support.page.windows import (
    OVERFLOW,
    PHONE,
    WIDTHS,
    OpenWindow,
    Visitor,
    go_offline,
)
from tests.support.waiting import until

pytestmark = pytest.mark.browser

VIEW_IS_UNCHANGED = """() => {
  const stage = document.querySelector(".stage");
  const before = stage.viewBefore;
  stage.viewBefore = stage.dataset.view;
  return before === stage.dataset.view;
}"""
SCALE = "parseFloat(document.querySelector('.stage').dataset.view)"


ORDERS = {"Random": "random", "By class": "class", "Doubtful": "doubt"}
LONG_KEY = f"{'a-long-name-of-a-drive-' * 4}/camera-front/0000000042"


def shows(page: Page, name: str) -> None:
    expect(page.locator(".inspector__head h2")).to_have_text(re.compile(rf" {name} ?$"))
    expect(page.locator(".stage")).to_have_attribute("data-picture", "shown")


def test_answer_key_saves_the_answer_and_shows_the_next_box(twenty_boxes, user):
    page = open_queue(user, twenty_boxes)
    pressed = {}

    for number, (key, verdict) in enumerate(
        [("a", "keep"), ("x", "reject"), ("Space", "unsure")], 1
    ):
        pressed[queued_box_id(page)] = verdict
        user.press(key)
        expect(page.locator(".queue__progress")).to_contain_text(
            f"{number} answered · {20 - number} unanswered"
        )

    assert queued_box_id(page) not in pressed
    user.wait_until_saved()
    assert answers(twenty_boxes) == pressed


def test_queue_zooms_to_the_box_and_view_keys_work(twenty_boxes, user):
    page = open_queue(user, twenty_boxes)
    stage = page.locator(".stage")
    expect(stage).to_have_attribute("data-mode", "crop")
    close = page.wait_for_function(SCALE).json_value()

    user.press("c")
    expect(stage).to_have_attribute("data-mode", "frame")
    # The zoom is animated.
    page.wait_for_function(f"close => {SCALE} < close / 2", arg=close)
    user.press("c")
    expect(stage).to_have_attribute("data-mode", "crop")
    user.press("f")
    expect(stage).to_have_attribute("data-mode", "frame")
    user.press("Escape")

    expect(stage).to_have_attribute("data-mode", "crop")
    page.wait_for_function(f"close => {SCALE} > 0.9 * close", arg=close)
    user.press("c")
    expect(stage).to_have_attribute("data-mode", "frame")
    user.press("a")

    expect(stage).to_have_attribute("data-mode", "crop")  # the next box
    expect(stage).not_to_have_attribute("data-highlighted", "")

    user.press("l", "m")

    expect(stage).to_have_attribute("data-highlighted", "")
    mask = page.get_by_role("button", name="Segmentation over the image")
    expect(mask).to_have_attribute("aria-pressed", "true")
    page.wait_for_function(VIEW_IS_UNCHANGED, polling=300)  # the zoom is animated
    before = page.evaluate(SCALE)
    user.press("+")
    page.wait_for_function(f"before => {SCALE} > before", arg=before)
    user.press("?")
    expect(page.get_by_role("dialog")).to_be_visible()


def test_next_and_previous_keys_skip_and_revisit_boxes(twenty_boxes, user):
    page = open_queue(user, twenty_boxes)
    first = queued_box_id(page)

    user.press("j")
    second = queued_box_id(page)
    user.press("ArrowRight")
    third = queued_box_id(page)
    user.press("ArrowLeft")
    shows(page, second)
    user.press("a")
    shows(page, third)
    user.press("ArrowLeft", "ArrowLeft")
    shows(page, first)
    user.press("Shift+J")

    shows(page, third)
    assert len({first, second, third}) == 3


def test_undo_returns_to_the_box_and_removes_its_last_answer(twenty_boxes, user):
    page = open_queue(user, twenty_boxes)
    first = queued_box_id(page)
    user.press("x")
    second = queued_box_id(page)
    user.press("a", "j")

    user.press("z")
    shows(page, second)
    expect(page.locator(".answerline")).to_have_text("It has no answer.")
    user.press("z")

    shows(page, first)
    expect(page.locator(".queue__progress")).to_contain_text(
        "0 answered · 20 unanswered"
    )
    user.wait_until_saved()
    assert answers(twenty_boxes) == {}

    # Of two answers on one box, only the second one is undone.
    pressed = {}

    for number, second in enumerate(["x", "a comment"], 1):
        box = queued_box_id(page)
        pressed[box] = "keep"
        user.press("a", "ArrowLeft")
        shows(page, box)
        if second == "x":
            user.press("x")
        else:
            page.get_by_label("Comment").fill(second)
            user.press("Enter")
        user.press("z")
        user.wait_until_saved()
        expect(page.locator(".queue__progress")).to_contain_text(
            f"{number} answered · {20 - number} unanswered"
        )
        assert answers(twenty_boxes) == pressed
        shows(page, box)
        user.press("j")


def test_comment_is_stored_with_the_answer_with_and_without_enter(twenty_boxes, user):
    page = open_queue(user, twenty_boxes)
    first = queued_box_id(page)

    user.press("e")
    expect(page.get_by_label("Comment")).to_be_focused()
    page.keyboard.type("a pole")
    user.press("Enter")
    shows(page, first)
    user.press("x")

    user.wait_until_saved()
    stored = twenty_boxes.review(first)
    assert (stored["verdict"], stored["comment"]) == ("reject", "a pole")

    second = queued_box_id(page)
    assert second != first
    field = page.get_by_label("Comment")
    field.fill("a wheel behind the bus")
    field.blur()
    user.press("j")
    expect(field).to_have_value("")
    user.press("ArrowLeft")
    expect(field).to_have_value("a wheel behind the bus")

    page.get_by_role("button", name=re.compile("^Reject")).click()

    expect(page.locator(".queue__progress")).to_contain_text("2 answered")
    user.wait_until_saved()
    stored = twenty_boxes.review(second)
    assert (stored["verdict"], stored["comment"]) == (
        "reject",
        "a wheel behind the bus",
    )


def test_held_down_key_or_enter_on_a_button_answers_only_one_box(twenty_boxes, user):
    page = open_queue(user, twenty_boxes)
    first = queued_box_id(page)
    user.wait_until_painted()

    for _ in range(4):  # a key that is held down: all but the first are repeats
        page.keyboard.down("a")
    page.keyboard.up("a")

    expect(page.locator(".queue__progress")).to_contain_text("1 answered")
    second = queued_box_id(page)
    for _ in range(2):
        page.keyboard.down("j")
    page.keyboard.up("j")
    expect(page.locator(".inspector__head h2")).not_to_contain_text(second)
    third = queued_box_id(page)
    keep = page.get_by_role("toolbar", name="Answer").get_by_role("button", name="Keep")
    keep.focus()
    for _ in range(5):
        page.keyboard.down("Enter")
    page.keyboard.up("Enter")

    expect(page.locator(".queue__progress")).to_contain_text("2 answered")
    user.wait_until_saved()
    assert answers(twenty_boxes) == {first: "keep", third: "keep"}


def test_g_key_opens_the_grid_and_back_returns_to_the_same_box(twenty_boxes, user):
    page = open_queue(user, twenty_boxes, verdict="rejected")
    user.press("x")
    here = queued_box_id(page)

    user.press("g")
    expect(page.locator(".cell").first).to_be_visible()
    assert page.url.endswith("/grid?bin=all&verdict=rejected")
    page.go_back()

    shows(page, here)
    expect(page.locator(".queue__progress")).to_contain_text(
        "1 answered · 9 unanswered"
    )


def test_queue_names_the_frame_of_the_box_and_links_to_it(make_scene, user):
    scene = make_scene(boxes=[])
    frame = scene.push(LONG_KEY, boxes=many_boxes.alternating_boxes(1))
    page = open_queue(user, scene)
    link = page.locator(".inspector__frame a")

    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": 844})
        expect(link).to_have_text(LONG_KEY)
        expect(link.get_by_text("0000000042", exact=True)).to_be_visible()
        assert page.evaluate(OVERFLOW) <= 0, width
        assert link.evaluate("link => link.getBoundingClientRect().right") <= width
    link.click()

    box = frame["boxes"][0]["box_id"]
    expect(page).to_have_url(re.compile(rf"#/frames/{frame['id']}\?box={box}$"))
    expect(page.locator(".inspector__frame")).to_have_count(0)


def test_v_key_and_filters_select_the_queued_boxes(twenty_boxes, user):
    page = open_queue(user, twenty_boxes)
    user.press("v")
    expect(page.locator(".queue__progress")).to_contain_text("10 unanswered")
    assert "verdict=kept" in page.url

    page.get_by_label("Verdict").select_option("rejected")

    expect(page.locator(".badge")).to_have_text("rejected")
    assert "verdict=rejected" in page.url
    page.get_by_role("button", name="Clear").click()
    expect(page.locator(".queue__progress")).to_contain_text("0 to review")


def test_queue_order_is_switched_and_kept_in_the_address(twenty_boxes, user):
    page = user.open(queue(twenty_boxes, order="audit"))
    expect(page.get_by_role("heading", name="Nothing to audit")).to_be_visible()

    for name, order in ORDERS.items():
        body = f'"order":"{order}"'
        with page.expect_response(
            lambda response, body=body: (
                response.url.endswith("/queue")
                and body in (response.request.post_data or "")
            )
        ) as response:
            page.get_by_role("group", name="Order").get_by_text(name).click()

        assert response.value.ok
        expect(page.locator(".stage")).to_have_attribute("data-picture", "shown")
        assert f"order={order}" in page.url


def test_boxes_outside_of_the_image_are_chosen_and_the_end_has_next_steps(scene, user):
    page = open_queue(user, scene)
    expect(page.locator(".queue__progress")).to_contain_text("4 unanswered")
    page.get_by_label("Reason").select_option("outside the image")
    expect(page.locator(".queue__progress")).to_contain_text("1 unanswered")
    shows(page, "away")

    page = open_queue(user, scene)
    expect(page.locator(".queue__progress")).to_contain_text("4 unanswered")
    user.press("j", "a", "x", "Space")

    expect(page.get_by_role("heading", name="All done")).to_be_visible()
    expect(page.locator(".notice")).to_contain_text("1 kept, 1 rejected, 1 unsure")
    page.get_by_role("button", name="Review it now").click()
    user.press("x")
    expect(page.locator(".notice")).to_contain_text("You answered 4 boxes")
    user.wait_until_saved()
    assert len(answers(scene)) == 4
    scene.push("run/000002")  # the queue goes on with what has come since
    expect(page.locator(".inspector__head")).to_contain_text("car hidden")
    user.press("x", "x", "x", "x")
    expect(page.locator(".notice")).to_contain_text("You answered 8 boxes")
    user.wait_until_saved()
    page.get_by_role("link", name="Audit the answers").click()
    expect(page.locator(".notice")).to_contain_text("nobody audits himself")
    for name in ("ghost", "real"):
        many_boxes.review_as(scene, "Berta", name, "keep")
    page.reload()
    expect(page.locator(".notice")).to_contain_text("nobody audits himself")


LARGEST = "thumbnail?width=16383"
"""The picture of a frame in its full size."""

ARE_LOADED = """(addresses) => {
  const loaded = performance.getEntriesByType("resource").map(({ name }) => name);
  return addresses.every((part) => loaded.some((name) => name.includes(part)));
}"""


def test_next_boxes_are_prefetched(scene, user):
    for number in (2, 3, 4):
        scene.push(f"run/{number:06d}")
    with user.page.expect_response("**/queue") as queued:
        page = open_queue(user, scene, order="random")
    frames = {box["frame_id"] for box in queued.value.json()["items"][:4]}
    shown = (LARGEST, "segmentation")
    pictures = [f"/frames/{number}/{kind}" for number in frames for kind in shown]
    page.wait_for_function(ARE_LOADED, arg=pictures)
    go_offline(page)

    stage = page.locator(".stage")
    for _ in range(3):
        answered = stage.get_attribute("data-box") or ""
        user.press("a")
        expect(stage).not_to_have_attribute("data-box", answered)
        expect(stage).to_have_attribute("data-picture", "shown")
        expect(page.locator(".stage-wrap .failure, .queue__note")).to_have_count(0)

    page.context.set_offline(False)
    user.wait_until_saved()
    verdicts = [box["review"]["verdict"] for box in many_boxes.answered_boxes(scene)]
    assert verdicts == ["keep"] * 3


def test_phone_has_large_answer_buttons_at_the_bottom(
    twenty_boxes, open_window: OpenWindow
):
    bo = open_window(viewport=PHONE, has_touch=True, is_mobile=True)
    page = open_queue(bo, twenty_boxes)
    first = queued_box_id(page)
    reject = page.get_by_role("button", name="Reject")
    box = bounds(reject)
    assert box["height"] >= 48
    assert box["width"] >= 88
    assert box["y"] + box["height"] > PHONE["height"] - 40

    reject.tap()

    bo.wait_until_saved()
    assert answers(twenty_boxes) == {first: "reject"}


def pixels_of_full_frame(user: Visitor, page: Page) -> np.ndarray:
    """Show the complete frame, and give the pixels of the stage's base layer.

    What only the current box has is drawn on another layer.
    """
    user.press("f")
    expect(page.locator(".stage")).to_have_attribute("data-mode", "frame")
    # What is drawn may still be what was there before other keys. The zoom is animated.
    wait_for_drawing(page)
    page.evaluate("delete document.querySelector('.stage').viewBefore")
    page.wait_for_function(VIEW_IS_UNCHANGED, polling=300)
    return base_pixels(page)


def base_pixels(page: Page) -> np.ndarray:
    return layer(page, "base")[..., :3].astype(int)


def test_full_frame_redraws_other_boxes_when_they_are_answered(make_scene, user):
    page = open_queue(user, make_scene(boxes=many_boxes.alternating_boxes(2)))
    first = queued_box_id(page)
    user.press("j")
    before = pixels_of_full_frame(user, page)
    user.press("ArrowLeft")
    shows(page, first)

    user.press("x" if first == "b0" else "a")

    pixels_of_full_frame(user, page)
    until(lambda: (base_pixels(page) != before).any(), "no box is drawn otherwise")


def test_blind_full_frame_hides_verdicts_of_unanswered_boxes(make_scene, user):
    page = open_queue(
        user, make_scene(boxes=many_boxes.alternating_boxes(4)), blind="on"
    )
    first = queued_box_id(page)
    user.press("Space", "ArrowLeft")
    shows(page, first)

    drawn = pixels_of_full_frame(user, page)

    assert np.ptp(drawn, axis=2).max() < 40, "a colour among greys"


def test_reservation_of_the_last_boxes_is_renewed_while_shown(make_scene, open_window):
    ten = make_scene(boxes=many_boxes.alternating_boxes(10))
    user = open_window(own=True)
    user.page.clock.install()
    page = user.open(queue(ten))
    expect(page.locator(".queue__progress")).to_contain_text("10 unanswered")
    # The page asks for more boxes, and does not renew while it waits for them.
    with page.expect_response("**/queue"):
        user.press("a", "a", "a", "a", "a")
    user.wait_until_saved()

    with page.expect_request("**/queue"):
        page.clock.run_for(5 * 60_000)


def test_queue_session_does_not_expire_while_it_is_shown(twenty_boxes, user):
    page = open_queue(user, twenty_boxes)
    user.press("a", "a", "j")
    here = queued_box_id(page)
    page.evaluate("{ const now = Date.now; Date.now = () => now() + 6 * 60_000; }")

    user.press("b")

    expect(page.locator(".badge")).to_have_count(0)
    expect(page.locator(".queue__progress")).to_contain_text("2 answered")
    assert queued_box_id(page) == here


def choose_class(page: Page) -> None:
    """As somebody who clicks the menu: it keeps the focus."""
    page.get_by_label("Class").select_option("car")
    page.get_by_label("Class").focus()


SLOW_CLOCK = """(() => {
  const now = performance.now.bind(performance);
  performance.now = () => now() / 50;
})()"""
"""Every answer is fast by the clock of the page, however slow the machine is."""


CONTROLS: dict[str, Callable[[Page], object]] = {
    "order": lambda page: page.get_by_role("button", name="Random").click(),
    "blind": lambda page: page.get_by_label("Blind").click(),
    "class": choose_class,
    "mask": lambda page: page.get_by_label("Segmentation over the image").click(),
    "zoom": lambda page: page.get_by_label("Zoom in").click(),
}


def test_answer_keys_answer_after_every_control_was_used(twenty_boxes, user):
    page = open_queue(user, twenty_boxes)
    question = page.get_by_role("dialog", name="12 answers in two seconds")
    page.add_locator_handler(
        question, lambda: question.get_by_role("button", name="I looked").click()
    )
    stored = 0
    # Space, which may also press what has the focus, and each of the other keys.
    for use, other in zip(CONTROLS.values(), ("a", "r", "u", "r", "u"), strict=True):
        for key in (other, "Space"):
            use(page)
            shown = queued_box_id(page)
            expect(page.locator(".stage")).to_have_attribute("data-picture", "shown")
            state = page.get_by_label("Blind").is_checked()

            user.press(key)

            user.wait_until_saved()
            stored += 1
            assert len(answers(twenty_boxes)) == stored
            assert shown in answers(twenty_boxes)
            assert page.get_by_label("Blind").is_checked() == state


def test_streak_faster_than_people_look_is_questioned_once_and_marked(
    twenty_boxes, user
):
    page = open_queue(user, twenty_boxes)
    page.evaluate(SLOW_CLOCK)
    order = []
    for _ in range(12):
        order.append(queued_box_id(page))
        user.press("a")

    question = page.get_by_role("dialog", name="12 answers in two seconds")
    question.get_by_role("button", name="Look at them again").click()

    expect(page.locator(".queue__listed")).to_contain_text("12 chosen boxes")
    assert queued_box_id(page) == order[0]
    expect(page.locator(".history").get_by_text("after a look of 0.")).to_be_visible()
    path = f"/boxes/{twenty_boxes.box_id(order[0])}/history"
    looked = twenty_boxes.http.get(path).json()["items"][0]["looked_ms"]
    assert 0 <= looked < 2000
    for _ in range(12):
        user.press("r")
    user.wait_until_saved()
    expect(page.get_by_role("dialog")).to_have_count(0)
    assert set(answers(twenty_boxes).values()) == {"reject"}


BOXES_OF_A_FRAME = [(60, 60), (400, 60), (60, 220), (400, 220)]

LATE_PICTURES_AND_WATCHED_KEYS = """(() => {
  const fetchNow = window.fetch;
  let asked = 0;
  window.fetch = async (...request) => {
    const url = String(request[0].url ?? request[0]);
    if (url.includes("/thumbnail?width=16383"))
      await new Promise((done) => setTimeout(done, [0, 90, 10, 250, 30][asked++ % 5]));
    return fetchNow(...request);
  };
  window.pressed = {};
  addEventListener("keydown", () => {
    const name = document.querySelector(".inspector__head h2")?.innerText;
    const canvas = document.querySelector(".stage canvas");
    if (!name || !canvas) return;  // at the end of the queue
    const [x, y] = [canvas.width / 2, canvas.height / 2];
    const middle = canvas.getContext("2d").getImageData(x, y, 1, 1).data;
    window.pressed[name.split(" ").at(-1)] = [...middle];
  }, true);
})()"""
"""Pictures come late, each after another time. At each key the pixel in the middle of
the stage is kept for the box that is shown, before the page gets the key."""


@pytest.mark.parametrize(
    "frames", [5, pytest.param(250, marks=[pytest.mark.long, pytest.mark.timeout(900)])]
)
def test_no_answer_by_keyboard_is_on_a_box_whose_picture_was_not_painted(
    make_scene, user, frames
):
    colours = {
        number: (30 + 40 * (number % 5), 30 + 40 * (number // 5 % 5), number // 25 * 20)
        for number in range(frames)
    }
    colours[0] = (scenes.GREY,) * 3

    def boxes_of(number: int) -> list[dict[str, Any]]:
        return [
            {"id": f"{number}-{place}", "class": "car", "xyxy": [x, y, x + 90, y + 60]}
            for place, (x, y) in enumerate(BOXES_OF_A_FRAME)
        ]

    scene = make_scene(boxes=boxes_of(0))
    for number in range(1, frames):
        own = {"boxes": boxes_of(number), "colour": colours[number]}
        scene.push(f"more/{number:06}", **own)
    page = open_queue(user, scene, sort="random")
    page.evaluate(LATE_PICTURES_AND_WATCHED_KEYS)
    question = page.get_by_role("button", name="I looked at each")
    end = page.get_by_role("heading", name="All done")
    while not end.is_visible():
        for key in "arraraarar":
            page.keyboard.press(key)
        if question.is_visible():
            question.click()
    # They are given faster than a busy server stores them.
    saved = re.compile("savestate--saved")
    expect(page.locator(".savestate")).to_have_class(saved, timeout=200_000)

    answered, cursor = set(), ""
    while cursor is not None:
        path = f"/boxes?dataset={scene.dataset}&review=any&limit=500&cursor={cursor}"
        boxes = scenes.get(scene.http, path)
        answered |= {box["id"] for box in boxes["items"]}
        cursor = boxes["next_cursor"]
    shown = page.evaluate("window.pressed")
    assert len(answered) == 4 * frames
    for name in answered:
        colour = colours[int(name.split("-")[0])]
        # WebP is lossy.
        assert shown[name][:3] == pytest.approx(colour, abs=2), name
