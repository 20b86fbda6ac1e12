"""No answer is lost: offline, after a reload, signed out, overtaken, across tabs."""

import re

import pytest
from playwright.sync_api import Page, expect

from tests.support.page import many_boxes, scenes
from tests.support.page.scenes import Scene
from tests.support.page.windows import Visitor, go_offline, lose_session
from tests.support.waiting import until

pytestmark = pytest.mark.browser


def save_state(page: Page):
    return page.locator(".savestate")


def test_top_bar_counts_unsaved_answers_and_says_when_the_server_is_away(
    scene: Scene, user: Visitor
):
    page = user.open(scene.link("ghost"))
    problem = {"code": "busy", "detail": "too many requests"}
    page.route("**/reviews", lambda route: route.fulfill(status=503, json=problem))

    user.press("a")

    expect(save_state(page)).to_contain_text(
        "1 answer waiting: server busy, trying again"
    )
    page.unroute("**/reviews")
    page.get_by_role("button", name="Retry").click()
    user.wait_until_saved()
    assert scene.review("ghost")["verdict"] == "keep"
    go_offline(page)
    page.get_by_role("link", name="Datasets", exact=True).click()

    expect(save_state(page)).to_have_text("The server does not answer")
    page.context.set_offline(False)
    user.wait_until_saved()


OFFLINE_UNTIL_RETRY = """(() => {
  const send = window.fetch;
  let isAsked = false;
  addEventListener("click", ({ target }) => {
    isAsked ||= target.closest("button")?.textContent.includes("Retry") ?? false;
  }, { capture: true });
  window.fetch = (place, ...more) =>
    String(place).endsWith("/reviews") && !isAsked
      ? Promise.reject(new TypeError("offline"))
      : send(place, ...more);
})()"""


def test_offline_answers_survive_a_reload_and_are_sent_by_retry(
    scene: Scene, user: Visitor
):
    page = user.page
    # Offline until the click: the page's own retry could come before it.
    page.add_init_script(OFFLINE_UNTIL_RETRY)
    user.open(scene.link("ghost"))

    user.press("a", "j", "x", "j", "x", "z")

    # The third one is undone before it was sent.
    expect(save_state(page)).to_contain_text("2 answers waiting: offline, kept here")
    expect(page.locator(".sign.is-waiting").first).to_be_visible()
    page.reload()
    user.wait_until_drawn()
    expect(page.locator(".sign.is-waiting")).to_have_count(2)
    assert [scene.revision(name) for name in ("ghost", "walker", "away")] == [0, 0, 0]
    page.locator(f"#box-{scene.box_id('ghost')}").click()
    expect(page.locator(".answerline")).to_contain_text("keep")
    expect(page.locator(".answerline__state")).to_have_text("not saved yet")
    page.get_by_role("button", name="Retry").click()
    user.wait_until_saved()
    assert scene.review("ghost")["verdict"] == "keep"
    assert scene.review("walker")["verdict"] == "reject"
    assert scene.revision("away") == 0


def test_unsent_answer_is_kept_while_signed_out(scene, user, server):
    page = user.open(scene.link("ghost"))
    lose_session(page)

    user.press("a")

    expect(page.get_by_role("heading", name="Sign in to Unghost")).to_be_visible()
    expect(page.locator(".signin__note")).to_contain_text("1 answer of admin kept")
    page.get_by_label("Token or login link").fill(server.token)
    page.get_by_role("button", name="Sign in").click()
    user.wait_until_drawn()
    expect(page.locator(".inspector__head h2")).to_have_text("truck ghost")
    user.wait_until_saved()
    assert scene.review("ghost")["verdict"] == "keep"


def test_overtaken_answer_is_given_up_or_replaces_the_other_one(scene, user):
    page = user.open(scene.link("walker"))
    notice = page.locator(".overtaken")
    many_boxes.review(scene, scene.box_id("walker"), "reject")
    user.press("a")
    page.get_by_role("button", name="Keep theirs").click()
    expect(notice).to_have_count(0)
    user.press("z")
    expect(page.locator(".toast", has_text="Nothing to undo.")).to_be_visible()
    assert scene.review("walker")["verdict"] == "reject"

    user.open(scene.link("ghost"))
    expect(page.locator(".answerline")).to_have_text("It has no answer.")
    many_boxes.review(scene, scene.box_id("ghost"), "reject")
    user.press("a")

    expect(notice).to_contain_text("admin answered reject while you answered keep")
    expect(page.locator(".answerline")).to_contain_text("reject by admin")
    assert scene.revision("ghost") == 1

    page.get_by_role("button", name="Use mine: keep").click()

    user.wait_until_saved()
    expect(notice).to_have_count(0)
    review = scene.review("ghost")
    assert (review["verdict"], review["revision"]) == ("keep", 2)


def test_overtaken_answer_on_another_frame_links_to_its_box(scene, user):
    scene.push("run/000002")
    page = user.page
    page.route("**/reviews", lambda route: route.abort())
    user.open(scene.link("ghost"))
    many_boxes.review(scene, scene.box_id("ghost"), "reject")
    user.press("a", "PageDown")
    expect(page.locator("h1")).to_have_text("run/000002")
    page.unroute("**/reviews")
    user.send_now()

    page.get_by_role("link", name="Show box").click()

    expect(page.locator("h1")).to_have_text("run/000001")
    expect(page.locator(".overtaken")).to_contain_text("Your answer was not saved")


def test_unsent_answers_of_a_tab_are_sent_by_others_only_once_it_is_closed(
    scene, open_window
):
    first = open_window()
    page = first.page
    page.route("**/reviews", lambda route: route.abort())
    first.open(scene.link("ghost"))
    first.press("a")
    expect(save_state(page)).to_contain_text("offline")
    context = page.context
    second = Visitor(context.new_page(), first.url)
    second.open(scene.link("real"))
    second.send_now()
    second.press("x")
    second.wait_until_saved()
    assert scene.review("real")["verdict"] == "reject"
    assert scene.revision("ghost") == 0
    page.close()
    second.page.close()

    third = Visitor(context.new_page(), first.url)
    third.open(scene.link("real"))

    # The page may be drawn before it knows which tabs are closed.
    until(lambda: scene.review("ghost") is not None)
    third.wait_until_saved()
    assert scene.review("ghost")["verdict"] == "keep"


def test_answer_of_another_tab_is_shown_before_and_after_it_is_stored(
    scene, open_window
):
    """This happens when a tab is reloaded and another tab takes over its answers."""
    first = open_window(own=True)
    first.page.route("**/reviews", lambda route: route.abort())
    first.open(scene.link("ghost"))
    first.press("a")
    expect(save_state(first.page)).to_contain_text("offline")

    second = Visitor(first.page.context.new_page(), first.url)
    second.open(scene.link("ghost"))

    state = second.page.locator(".answerline__state")
    expect(second.page.locator(".answerline")).to_contain_text("keep")
    expect(state).to_have_text("not saved yet")
    first.page.unroute("**/reviews")
    first.send_now()
    first.wait_until_saved()
    expect(second.page.locator(".answerline")).to_contain_text("keep by admin")
    expect(state).to_have_text("saved")


def test_box_is_kept_or_rejected_only_once_its_picture_was_painted(scene, user):
    page = user.page
    page.route(re.compile(r"/thumbnail\?width=16383"), lambda route: route.abort())
    page.goto(f"{user.url}/{scene.link('hidden')}")
    expect(page.get_by_role("alert").filter(has_text="Image:")).to_be_visible()
    expect(page.locator(".box")).to_have_count(5)

    user.press("x")
    expect(page.get_by_text("is not on the screen yet")).to_be_visible()
    user.press("u")
    user.wait_until_saved()
    assert scene.review("hidden")["verdict"] == "unsure"

    page.unroute(re.compile(r"/thumbnail\?width=16383"))
    # It is asked for again without a click.
    expect(page.locator(".stage")).to_have_attribute("data-picture", "shown")
    user.press("x")
    user.wait_until_saved()
    assert scene.review("hidden")["verdict"] == "reject"


def test_html_in_ids_classes_and_comments_is_shown_as_text(make_scene, user):
    evil = "<img src=x onerror=alert(1)>"
    boxes = [{"id": evil, "class": evil, "xyxy": scenes.CAR}]
    scene = make_scene(boxes=boxes)
    page = user.open(scene.link(evil))

    user.press("x", "e")
    page.keyboard.type(evil)
    user.press("Enter")

    expect(page.locator(".history__comment")).to_have_text(evil)
    expect(page.locator(".inspector__head h2")).to_have_text(
        re.compile(re.escape(evil))
    )
    expect(page.locator("img[src=x]")).to_have_count(0)
