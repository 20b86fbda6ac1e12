"""Answers for boxes like the last one, and for one object in several frames."""

import pytest
from playwright.sync_api import expect

from tests.support.page import scenes
from tests.support.page.accessibility import findings
from tests.support.page.many_boxes import answers, queue
from tests.support.page.stage import wait_for_drawing
from tests.support.page.windows import OVERFLOW, PHONE

pytestmark = pytest.mark.browser

X, Y = scenes.SKY[:2]


def ghost(name, distance, right=0):
    xyxy = [X + right, Y, X + right + 40, Y + 30]
    return {"id": name, "class": "car", "xyxy": xyxy, "distance": distance}


@pytest.fixture
def ghosts(make_scene):
    """Four ghosts within 50 m, one farther away, and a car that is seen."""
    near = [ghost(f"g{n}", 10 + n, 4 * n) for n in range(4)]
    car = {"id": "real", "class": "car", "xyxy": scenes.CAR, "distance": 12}
    return make_scene(boxes=[*near, ghost("far", 120), car])


def expect_progress(page, text):
    expect(page.locator(".queue__progress")).to_contain_text(text)


def answer_first(user, scene, name, key="x", **query):
    page = user.open(queue(scene, box=str(scene.box_id(name)), **query))
    expect(page.locator(".stage")).to_have_attribute(
        "data-painted", str(scene.box_id(name))
    )
    user.press(key)
    return page


def test_all_like_the_last_one_get_its_answer_by_one_key_and_one_undo(ghosts, user):
    page = answer_first(user, ghosts, "g0")
    user.press("s")
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("All like car g0")
    expect(dialog.get_by_role("status")).to_have_text("3 others, 3 probably the same")
    expect(dialog.locator(".alike__box img")).to_have_count(3)
    assert findings(page) == []
    dialog.get_by_role("button", name="car g2").click()
    expect(dialog.locator(".alike__give")).to_have_text("Reject 2 boxes")
    user.press("s")

    expect(dialog).to_be_hidden()
    expect(page.locator(".queue__progress")).to_contain_text(
        "3 answered · 3 unanswered"
    )
    user.wait_until_saved()
    rejected = {"g0": "reject", "g1": "reject", "g3": "reject"}
    assert answers(ghosts) == rejected
    history = scenes.get(ghosts.http, f"/boxes/{ghosts.box_id('g1')}/history")
    entry = history["items"][0]
    assert (entry["batch_size"], entry["looked_at"]) == (2, 2)

    user.press("z")
    expect(page.locator(".queue__progress")).to_contain_text(
        "1 answered · 5 unanswered"
    )
    user.wait_until_saved()
    assert answers(ghosts) == {"g0": "reject"}


def test_history_tells_how_many_of_a_bulk_answer_were_looked_at(ghosts, user):
    ids = [ghosts.box_id(name) for name in ("g0", "g1", "g2")]
    body = {"dataset": ghosts.dataset, "box_ids": ids, "verdict": "reject"}
    response = ghosts.http.post("/reviews/bulk", json={**body, "looked_at": 1})
    assert response.status_code == 201, response.text

    page = user.open(ghosts.link("g1"))

    expect(page.locator(".history")).to_contain_text("one of 3 at once, 1 of them")
    user.open(queue(ghosts))
    expect(page.locator(".stage")).to_have_attribute("data-picture", "shown")

    user.press("s")

    expect(page.get_by_text("Answer a box first")).to_be_visible()


@pytest.fixture
def drive(make_scene):
    """Four frames of a recording; car 7 is visible in the first two of them."""
    scene = make_scene(boxes=[])
    places = [scenes.CAR, scenes.CAR, scenes.SKY, scenes.SKY]
    for number, xyxy in enumerate(places, 2):
        box = {"id": "7", "class": "car", "xyxy": xyxy, "distance": 30 + number}
        frame = scene.push(f"run/{number:06}", boxes=[box])
    return scenes.Scene(scene.http, scene.dataset, frame)


def open_last(user, drive):
    page = user.open(queue(drive, box=str(drive.box_id("7"))))
    expect(page.locator(".track__box")).to_have_count(4)
    expect(page.locator(".stage")).to_have_attribute(
        "data-painted", str(drive.box_id("7"))
    )
    return page


def test_frames_before_are_shown_and_one_answer_is_for_a_track(drive, user):
    page = open_last(user, drive)
    expect(page.locator(".track__words")).to_have_text("visible two frames ago")

    user.press(",", ",")
    expect(page.locator(".question__ask")).to_contain_text("2 frames earlier:")
    shown = page.locator(".track__box[aria-current]")
    expect(shown.locator(".track__offset")).to_contain_text("−2 frames: car 7")
    wait_for_drawing(page)
    user.press("x")

    # The picture of another frame answers nothing.
    expect(page.get_by_text("another frame was on show")).to_be_visible()
    expect(page.locator(".question__ask")).to_contain_text("Can you see")
    assert drive.review("7") is None

    items = scenes.get(drive.http, f"/boxes/{drive.box_id('7')}/track")["items"]
    ids = [item["box_id"] for item in items]

    user.press("Shift+X")
    user.wait_until_saved()
    reviews = [scenes.get(drive.http, f"/boxes/{box_id}")["review"] for box_id in ids]
    assert [review["verdict"] for review in reviews] == ["reject"] * 4
    expect(page.locator(".queue__message")).to_contain_text("All done")

    user.press("z")
    user.wait_until_saved()
    assert [scenes.get(drive.http, f"/boxes/{box_id}")["review"] for box_id in ids] == (
        [None] * 4
    )
    expect(page.locator(".queue__progress")).to_contain_text(
        "0 answered · 4 unanswered"
    )


def test_strip_of_frames_fits_a_phone(drive, open_window):
    user = open_window(viewport=PHONE)
    page = open_last(user, drive)

    assert page.evaluate(OVERFLOW) <= 0
    assert findings(page) == []
    expect(page.get_by_role("button", name="Keep all")).to_be_visible()
