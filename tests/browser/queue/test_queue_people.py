"""The queue with several people, without a network, and in an audit (blind)."""

import pytest
from playwright.sync_api import expect

from tests.support.page import many_boxes
from tests.support.page.many_boxes import answers, open_queue, queued_box_id

pytestmark = [pytest.mark.browser, pytest.mark.long]


def test_boxes_with_unsent_answers_are_not_queued_after_a_reload(twenty_boxes, user):
    page = user.page
    page.route("**/reviews", lambda route: route.abort())
    open_queue(user, twenty_boxes)
    first = queued_box_id(page)
    user.press("x")
    expect(page.locator(".savestate")).to_contain_text("1 answer waiting: offline")

    page.reload()
    expect(page.locator(".stage")).to_have_attribute("data-picture", "shown")

    assert queued_box_id(page) != first
    page.unroute("**/reviews")
    expect(page.locator(".savestate--saved")).to_be_visible(timeout=40_000)
    assert answers(twenty_boxes) == {first: "reject"}


def test_audit_hides_verdict_and_answers_until_answered(scene, user):
    many_boxes.review_as(scene, "Berta", "ghost", "keep")
    many_boxes.review_as(scene, "Berta", "real", "keep")
    page = open_queue(user, scene, order="audit", **{"class": "truck"})
    body = page.locator(".queue__body")
    expect(page.get_by_label("Blind")).to_be_checked()
    for told in ("kept", "rejected", "Berta", "too few visible pixels", "Pedestrian"):
        assert told not in body.inner_text()
    assert page.locator(".sign, .badge, .match").count() == 0
    assert page.locator(".stage").get_attribute("aria-label") == "Box: truck ghost"

    user.press("x")

    expect(page.get_by_role("heading", name="All done")).to_be_visible()
    expect(page.locator(".queue__progress")).to_contain_text("agreed on 0 of 1")
    user.wait_until_saved()
    assert scene.review("ghost")["verdict"] == "reject"
    user.press("ArrowLeft")
    expect(page.locator(".answerline")).to_contain_text("reject")


def test_agreement_is_shown_beside_the_next_box(twenty_boxes, user):
    for name in ("b0", "b2"):
        many_boxes.review_as(twenty_boxes, "Berta", name, "keep")
    page = open_queue(user, twenty_boxes, order="audit")
    first = queued_box_id(page)

    user.press("a")

    expect(page.locator(".agreement")).to_have_text(
        f"car {first}: you and Berta agree, keep"
    )
    expect(page.locator(".queue__progress")).to_contain_text("1 of 2 audited")
    user.wait_until_saved()
    assert twenty_boxes.revision(first) == 2
