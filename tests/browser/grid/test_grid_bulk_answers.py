"""Answering many boxes at once in the grid: sending, undoing, offline, conflicts."""

import re

import httpx
import pytest
from playwright.sync_api import Page, Route, expect

from tests.support.page import many_boxes
from tests.support.page.many_boxes import answers, cell, grid, open_grid, selected
from tests.support.page.scenes import MakeScene, Scene
from tests.support.page.windows import (
    OpenWindow,
    Visitor,
    first_held,
    go_offline,
    hold_timers,
    route_loaded,
)

pytestmark = [pytest.mark.browser, pytest.mark.long]


@pytest.fixture
def many(make_scene: MakeScene) -> Scene:
    """Thirty boxes: b0, b2, ... are kept, b1, b3, ... are rejected."""
    return make_scene(boxes=many_boxes.alternating_boxes(30))


@pytest.fixture
def page(many: Scene, user: Visitor) -> Page:
    """The grid of these boxes, once its list is loaded."""
    return open_grid(user, many)


def select_range(page: Page, first: int, last: int) -> None:
    cell(page, first).click()
    cell(page, last).click(modifiers=["Shift"])


def strip(page: Page):
    return page.locator(".strip")


def toast(page: Page):
    return page.locator(".toast").last


def reject_first_three(user: Visitor) -> None:
    """Reject b0, b1 and b2 with one answer, and wait until it is stored."""
    select_range(user.page, 0, 2)
    user.press("x")
    expect(toast(user.page)).to_contain_text("3 boxes rejected")


@pytest.mark.parametrize(
    ("key", "button", "verdict", "words"),
    [
        ("a", "", "keep", "3 boxes kept"),
        ("r", "", "reject", "3 boxes rejected"),
        ("u", "", "unsure", "3 boxes flagged as unsure"),
        ("x", "Reject", "reject", "3 boxes rejected"),
    ],
    ids=["key A", "key R", "key U", "button"],
)
def test_key_or_button_answers_all_selected_boxes(
    many, user, page, key, button, verdict, words
):
    user.press(key)
    expect(toast(page)).to_contain_text("Select boxes first")
    select_range(page, 1, 3)
    bar = page.get_by_role("toolbar", name="Answer for the selected boxes")
    expect(bar).to_contain_text("3 selected")

    if button:
        bar.get_by_role("button", name=button).click()
    else:
        user.press(key)

    expect(toast(page)).to_contain_text(words)
    assert answers(many) == dict.fromkeys(("b1", "b2", "b3"), verdict)
    expect(page.locator(f".sign--{verdict}")).to_have_count(3)
    assert selected(page) == []


def test_delete_key_removes_the_answers_of_those_selected_boxes_that_have_one(
    many, user, page
):
    select_range(page, 1, 3)
    user.press("x")
    expect(toast(page)).to_contain_text("3 boxes rejected")
    select_range(page, 2, 3)

    user.press("Delete")

    expect(toast(page)).to_contain_text("2 boxes without an answer again")
    assert answers(many) == {"b1": "reject"}
    select_range(page, 0, 3)
    user.press("Delete")
    expect(toast(page)).to_contain_text("1 box without an answer again")
    select_range(page, 0, 3)
    user.press("Delete")
    expect(toast(page)).to_have_text("None of these boxes has an answer.")


def test_undo_reverts_only_the_latest_bulk_answer(many, user, page):
    select_range(page, 0, 1)
    user.press("x")
    expect(toast(page)).to_contain_text("2 boxes rejected")
    select_range(page, 2, 5)
    user.press("a")
    expect(toast(page)).to_contain_text("4 boxes kept")

    user.press("z")

    expect(toast(page)).to_contain_text("4 answers undone")
    assert answers(many) == {"b0": "reject", "b1": "reject"}
    expect(page.locator(".sign--keep")).to_have_count(0)
    expect(page.locator(".sign--reject")).to_have_count(2)
    user.press("z")
    expect(toast(page)).to_contain_text("2 answers undone")
    assert answers(many) == {}
    select_range(page, 0, 1)
    user.press("x")
    page.get_by_role("button", name="Undo").click()

    expect(toast(page)).to_contain_text("2 answers undone")
    expect(page.get_by_role("button", name="Undo")).to_have_count(0)
    user.press("z")
    expect(toast(page)).to_contain_text("Nothing to undo")


def test_undo_skips_and_lists_boxes_answered_since(many, user, page):
    reject_first_three(user)
    many_boxes.review(many, many.box_id("b1"), "keep")

    user.press("z")

    expect(strip(page)).to_contain_text("1 answer was left as it is")
    expect(strip(page).get_by_role("link")).to_have_text("car b1")
    assert answers(many) == {"b1": "keep"}
    strip(page).get_by_role("button", name="Dismiss").click()
    expect(strip(page)).to_have_count(0)


def test_bulk_answer_whose_response_is_lost_can_be_undone_but_not_discarded(
    many, user, page
):
    hold_timers(page, 1000)  # the answer is not sent again before it is undone
    held: list[Route] = []
    route_loaded(page, "**/reviews/bulk", lambda route: held.append(route))
    select_range(page, 0, 2)
    user.press("x")
    bulk = first_held(page, held)
    bulk.fetch()
    bulk.abort()
    expect(strip(page)).to_contain_text("Not sent yet: reject 3 boxes.")
    assert len(answers(many)) == 3

    expect(strip(page).get_by_role("button", name="Discard")).to_have_count(0)
    strip(page).get_by_role("button", name="Undo").click()
    expect(page.locator(".sign--reject")).to_have_count(0)
    expect(strip(page)).to_have_text(re.compile("undo the answers on 3 boxes"))
    page.unroute("**/reviews/bulk")  # the request that is held goes to the server

    user.wait_until_saved()
    assert answers(many) == {}


def test_refused_bulk_answer_can_be_sent_again(many, user, page):
    problem = {"status": 403, "detail": "viewers answer nothing"}

    def forbid(route: Route) -> None:
        route.fulfill(status=403, json=problem)

    route_loaded(page, "**/reviews/bulk", forbid)
    select_range(page, 0, 2)
    user.press("x")
    expect(strip(page)).to_contain_text(
        "Refused: reject 3 boxes. Viewers answer nothing."
    )
    expect(page.locator(".sign--reject")).to_have_count(0)
    page.unroute("**/reviews/bulk")
    assert answers(many) == {}
    strip(page).get_by_role("button", name="Send again").click()

    expect(toast(page)).to_contain_text("3 boxes rejected")
    expect(strip(page)).to_have_count(0)
    assert set(answers(many).values()) == {"reject"}


def test_answered_boxes_stay_listed_until_the_list_is_updated(many, user):
    page = user.open(grid(many, review="undecided"))
    expect(page.locator(".grid-status p")).to_have_text("30 boxes")
    select_range(page, 0, 4)
    user.press("x")
    expect(toast(page)).to_contain_text("5 boxes rejected")
    expect(cell(page, 0).locator(".sign--reject")).to_be_visible()

    page.get_by_role("button", name="5 boxes no longer match").click()

    expect(page.locator(".grid-status p")).to_contain_text("25 boxes")
    expect(page.locator(".sign")).to_have_count(0)


def test_bulk_answer_on_a_filter_is_stored_and_undone(many, user):
    page = user.open(grid(many))
    page.get_by_role("button", name="Select all 30").click()

    user.press("a")

    expect(toast(page)).to_contain_text("30 boxes kept")
    assert set(answers(many).values()) == {"keep"}
    expect(page.locator(".sign--keep")).to_have_count(30)
    user.press("z")
    expect(toast(page)).to_contain_text("30 answers undone")
    expect(page.locator(".sign")).to_have_count(0)
    assert answers(many) == {}


def give_refused_bulk_answer(many: Scene, user: Visitor, **others: str) -> Page:
    """Reject all undecided boxes, after somebody else has given these answers."""
    page = user.open(grid(many, review="undecided"))
    page.get_by_role("button", name="Select all 30").click()
    for name, verdict in others.items():
        many_boxes.review(many, many.box_id(name), verdict)
    user.press("x")
    expect(strip(page)).to_contain_text("Not done: reject 30 boxes.")
    return page


def test_bulk_answer_is_refused_if_the_filter_count_changed(many, user):
    page = give_refused_bulk_answer(many, user, b0="keep")
    assert answers(many) == {"b0": "keep"}
    strip(page).get_by_role("button", name="Count again").click()
    expect(strip(page)).to_contain_text("29 boxes now, 30 when you selected them")
    assert len(answers(many)) == 1
    strip(page).get_by_role("button", name="reject all 29").click()

    expect(toast(page)).to_contain_text("29 boxes rejected")
    expect(strip(page)).to_have_count(0)
    assert answers(many)["b0"] == "keep"
    assert len(answers(many)) == 30


def test_count_again_names_flags_that_a_bulk_answer_would_replace(many, user):
    page = give_refused_bulk_answer(many, user, b0="unsure", b1="unsure")

    strip(page).get_by_role("button", name="Count again").click()

    expect(strip(page)).to_contain_text("2 of these have an answer, which yours would")


def test_undo_discards_a_refused_bulk_answer_and_says_so(many, user):
    page = give_refused_bulk_answer(many, user, b0="keep")

    user.press("z")

    expect(toast(page)).to_contain_text("Discarded: reject 30 boxes")
    expect(strip(page)).to_have_count(0)
    assert answers(many) == {"b0": "keep"}


def test_bulk_answer_skips_and_lists_boxes_answered_by_others(
    many: Scene, open_window: OpenWindow
):
    ada, bo = open_window(), open_window()
    hers, his = open_grid(ada, many), open_grid(bo, many)
    cell(his, 1).click()
    bo.press("a")
    expect(toast(his)).to_contain_text("1 box kept")
    select_range(hers, 0, 2)

    ada.press("x")

    expect(toast(hers)).to_contain_text("2 boxes rejected")
    expect(strip(hers)).to_contain_text("1 box was left out: somebody has answered")
    expect(strip(hers).get_by_role("link")).to_have_text("car b1")
    expect(cell(hers, 1).locator(".sign--keep")).to_be_visible()
    assert answers(many) == {"b0": "reject", "b1": "keep", "b2": "reject"}
    ada.press("z")
    expect(toast(hers)).to_contain_text("2 answers undone")
    expect(cell(hers, 1).locator(".sign--keep")).to_be_visible()
    expect(hers.locator(".sign--reject")).to_have_count(0)
    assert answers(many) == {"b1": "keep"}


def test_offline_answer_and_its_undo_are_kept_and_sent_when_online(many, user, page):
    page.context.set_offline(True)
    select_range(page, 0, 2)

    user.press("x")

    expect(strip(page)).to_contain_text("Not sent yet: reject 3 boxes.")
    expect(page.locator(".sign.is-waiting")).to_have_count(3)
    expect(page.locator(".savestate")).to_contain_text(
        "3 answers waiting: offline, kept here"
    )
    assert answers(many) == {}
    page.context.set_offline(False)
    expect(toast(page)).to_contain_text("3 boxes rejected")
    expect(strip(page)).to_have_count(0)
    assert len(answers(many)) == 3
    go_offline(page)

    user.press("z")

    expect(page.locator(".sign--reject")).to_have_count(0)
    expect(page.locator(".savestate")).to_contain_text(
        "3 answers waiting: offline, kept here"
    )
    expect(strip(page)).to_contain_text("Not sent yet: undo the answers on 3 boxes.")
    page.context.set_offline(False)
    expect(toast(page)).to_contain_text("3 answers undone")
    expect(strip(page)).to_have_count(0)
    user.wait_until_saved()
    assert answers(many) == {}


def test_unsent_bulk_answer_can_be_sent_or_discarded_manually(many, user, page):
    # So long that the page does not send the answer by itself before the button does.
    later = {"Retry-After": "600"}
    route_loaded(
        page,
        "**/reviews/bulk",
        lambda route: route.fulfill(status=503, headers=later, json={}),
    )
    select_range(page, 0, 2)
    user.press("x")
    expect(strip(page)).to_contain_text("reject 3 boxes")
    select_range(page, 4, 5)
    user.press("x")
    second = strip(page).filter(has_text="reject 2 boxes")
    second.get_by_role("button", name="Discard").click()
    expect(page.locator(".sign")).to_have_count(3)

    page.unroute("**/reviews/bulk")
    strip(page).get_by_role("button", name="Send now").click()

    expect(toast(page)).to_contain_text("3 boxes rejected")
    assert set(answers(many)) == {"b0", "b1", "b2"}


def test_bulk_answer_skips_and_counts_deleted_boxes(
    many: Scene, user: Visitor, http: httpx.Client
):
    many.push("run/000002", boxes=many_boxes.alternating_boxes(2))
    page = user.open(grid(many))
    expect(page.locator(".grid-status p")).to_have_text("32 boxes")
    path = f"/datasets/{many.dataset}/frames/run/000002"
    assert http.delete(path).status_code == 204
    page.get_by_role("grid").focus()
    user.press("End")
    cell(page, 28).click()
    cell(page, 31).click(modifiers=["Shift"])

    user.press("x")

    expect(strip(page)).to_contain_text("2 boxes were left out")
    expect(toast(page)).to_contain_text(re.compile("^2 boxes rejected"))
    assert answers(many) == {"b28": "reject", "b29": "reject"}
